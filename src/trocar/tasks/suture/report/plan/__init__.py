"""Suture plans as pictures, tables and plain values."""
