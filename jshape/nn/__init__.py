"""Networks from images to images; nothing here knows what the images mean."""
