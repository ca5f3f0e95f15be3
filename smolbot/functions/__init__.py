"""What a program or a notebook calls; the command line is a shell over it. Public as names of `smolbot` itself."""
