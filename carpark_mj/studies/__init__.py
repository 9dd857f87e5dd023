"""The studies behind this gym, each an extension of the core (`extensions`)."""
