"""The server of a fleet: streams found on Zenoh, changed and watched over REST. `app.create_app` makes it."""
