"""Find the pad in a frame without a prior: candidates, alignment of a template, verification."""
