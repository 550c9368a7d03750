"""Pads of one's own: made from drawings and photographs, and priced by how often clutter is taken for them."""
