"""The backend for DDS, by Cyclone DDS."""
