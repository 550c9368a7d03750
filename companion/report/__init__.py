"""What a person looks at after a flight: a folder with one page, its plots and an annotated video."""
