"""KITTI folders as the packets of their sensor."""
