"""What the explorer's pages show, as typed values."""
