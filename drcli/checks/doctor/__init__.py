"""What `dr doctor` examines: the installation, the machine, the bucket and what earlier runs left.

One module for each subject. Nothing here changes a file or an object that it did not create.
"""
