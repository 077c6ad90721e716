"""Pure functions on angles, frames, oriented boxes and polylines."""
