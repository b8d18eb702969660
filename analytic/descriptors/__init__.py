"""Descriptors: one file each, one interface."""
