"""Policy servers: Ray actors that answer in batches, and a websocket server."""
