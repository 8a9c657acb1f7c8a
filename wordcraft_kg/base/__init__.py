"""The ground of all rooms: errors, records, settings, labels, artefacts, statistics."""
