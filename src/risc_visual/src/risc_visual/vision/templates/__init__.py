"""Small, complete vision algorithms to start your own from (thesis 4.4.2). Pure OpenCV: a picture in, values out.

Pictures are (h, w, 3) uint8 in OpenCV's order blue, green, red; pixels are (x right, y down) from the top left.
"""
