"""Whether a contact could have been avoided, and by which driver."""
