"""Recognition of the contact state by the reciprocity of wrenches and contacts."""
