"""What exists for one experiment of the book only: other bounds on the discriminator."""
