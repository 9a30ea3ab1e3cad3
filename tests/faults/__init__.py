"""Faults made on purpose: each row of the table in docs/operations.md is one file here, measured by running it."""

ROWS = (
    "publisher_killed",
    "subscriber_killed",
    "router_killed",
    "link_slowed",
    "link_cut",
    "messages_dropped",
    "messages_bursts",
    "messages_delayed",
    "messages_reordered",
    "messages_repeated",
    "disk_full",
    "server_restarted",
    "past_fetched",
    "past_killed",
    "clock_jumped",
    "hostile_rest",
    "hostile_zenoh",
    "archive_killed",
    "archive_cluster_killed",
    "archive_store_errors",
    "archive_disk_full",
    "archive_clock_jumped",
)
"""Modules, in the order of the table."""
