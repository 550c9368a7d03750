"""Renderer of deck, pad, ship, sea and the light on them."""
