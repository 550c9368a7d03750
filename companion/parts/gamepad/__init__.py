"""A gamepad as a sender of orders, and as sticks."""
