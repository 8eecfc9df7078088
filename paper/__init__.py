"""The paper: its figures from our data, and studies beside them (`osc-contact reproduce`)."""
