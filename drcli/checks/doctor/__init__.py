"""What `dr doctor` examines.

Nothing here changes a file or an object that it did not create.
"""
