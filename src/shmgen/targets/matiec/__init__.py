"""matiec, the compiler of OpenPLC v3 and of Beremiz: types and blocks whose bodies are in C."""
