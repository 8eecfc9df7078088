"""The control law box by box in plain NumPy: an independent oracle for `osc_contact.law`."""
