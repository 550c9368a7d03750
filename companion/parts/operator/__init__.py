"""The senders of orders beside the links: a local socket for terminals, and a gamepad."""
