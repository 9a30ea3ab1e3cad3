"""The receiver of a stream: messages in, frames out, and what is done with them."""
