"""The command `osc-contact`."""
