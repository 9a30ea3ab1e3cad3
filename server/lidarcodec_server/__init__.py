"""The server of a fleet: it finds streams on Zenoh, and controls and shows them over REST. See `app.create_app`."""
