"""Plans, starts and continues runs, and observes them."""
