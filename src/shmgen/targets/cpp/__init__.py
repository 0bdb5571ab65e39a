"""C++17 messages with publishers, subscribers, clients and servers, on top of the C headers."""
