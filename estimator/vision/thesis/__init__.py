"""The three detection methods of the thesis: ellipse, corners of the H, arrow; and the choice between them."""
