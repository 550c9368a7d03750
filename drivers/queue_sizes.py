"""Sizes of queues that settings name too; apart from the queues, so that settings can be read without asyncio."""

SAMPLE_QUEUE_ITEMS = 4096
"""The default number of samples kept for a slow reader before the oldest are dropped: those of at least two seconds."""
