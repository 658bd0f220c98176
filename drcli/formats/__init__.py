"""The forms in which a policy leaves and arrives: files of other systems, read and written."""
