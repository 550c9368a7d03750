"""The flight as it happens, in Foxglove and Lichtblick, by their websocket protocol."""
