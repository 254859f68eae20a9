"""Which expert a first observation belongs to, by routers with and without labels."""
