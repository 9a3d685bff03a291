"""CRTK, the topics that da Vinci Research Kits speak, over ROS 2 without a ROS installation (``pip install .[crtk]``).

Tested so far: messages were exchanged with the real ``rclpy`` (Fast DDS) on one machine, in both directions, and with
this package's own server. No physical arm has been driven.
"""
