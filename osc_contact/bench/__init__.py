"""What one control tick costs beside its floor (`osc-contact bench tick`)."""
