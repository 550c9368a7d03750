"""The operator page: live picture, state, health and orders in a browser, served by the service itself."""
