"""What a flight needs around the loop: the session, the checks before it, the service manager.

May import every room but cli.
"""
