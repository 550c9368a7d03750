"""Pure estimation: values in, values out. No sockets, files, clocks, asyncio or logging."""
