"""What the prose says about results: passages whose numbers are computed, and the conditions that make them true."""
