"""`robogauntlet serve`: serve the dashboard, or a policy."""
