"""What each perturbation axis does to the shipped policies."""
