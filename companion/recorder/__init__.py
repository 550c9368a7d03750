"""What the service heard, decided and said, as MCAP files: written beside the flight, read back for replay."""
