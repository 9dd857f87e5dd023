"""Physics back ends: controls in, `Motion` out."""
