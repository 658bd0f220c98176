"""Other systems over the network: DeepRacer on AWS, and the web page of the physical car."""
