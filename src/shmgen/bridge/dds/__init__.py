"""The backend for DDS, through Cyclone DDS."""
