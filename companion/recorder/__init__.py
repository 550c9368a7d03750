"""Record the service's inputs, decisions and outputs as MCAP files during the flight, and read them back for replay."""
