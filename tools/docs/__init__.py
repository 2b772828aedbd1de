"""Make pages and images of docs/."""
