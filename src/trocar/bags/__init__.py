"""Bags, the recordings of ROS, read and written without ROS (``pip install .[bags]``)."""
