"""Bytes and frozen messages of the devices' own protocols. Pure: no asyncio, no sockets, nothing else of hal."""
