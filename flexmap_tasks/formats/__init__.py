"""The only doors to the outside: file formats in and out."""
