"""Why nothing happens: a frame of the whole set-up, and rules that name every known fault with its fix."""
