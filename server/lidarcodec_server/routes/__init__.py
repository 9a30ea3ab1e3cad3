"""The routes: short translations between HTTP and `service`."""
