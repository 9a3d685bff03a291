"""Poses of board and blocks from images and point clouds."""
