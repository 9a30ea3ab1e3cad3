"""Maps for localisation: built from drives, reduced, and kept in small files of tiles (`.lcmap`)."""
