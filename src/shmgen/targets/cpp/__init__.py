"""C++17: messages, and their publishers, subscribers, clients and servers, on top of the headers for C."""
