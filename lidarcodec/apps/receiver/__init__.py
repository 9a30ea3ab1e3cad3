"""The receiver of a stream: messages in, frames out, and outputs for the frames."""
