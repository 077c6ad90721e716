"""What `doctor` looks at; each check by itself, so that what is broken cannot take it along."""
