"""The images without a container engine: `python -m tests.images` builds and runs them in a chroot; docs/images.md."""
