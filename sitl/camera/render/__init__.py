"""What the renderer draws: deck, pad, ship, sea and the light on them."""
