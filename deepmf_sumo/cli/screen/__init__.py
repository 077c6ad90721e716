"""What commands show: tables and live lines."""
