"""What developers run beside the program: fuzzers, studies, and what makes the pages and images of docs/."""
