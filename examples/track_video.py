"""Track a box through a video: `python examples/track_video.py clip.mp4 309,192,22,48`."""

import sys

import cv2

import racf

racf.one_core()
video, tracker = cv2.VideoCapture(sys.argv[1]), racf.Racf("racf,robust")
tracker.init(video.read()[1], racf.Box.parse(sys.argv[2]))  # x,y,w,h in the first image
while (image := video.read()[1]) is not None:
    track = tracker.update(image)
    print(track.box, f"{track.confidence:.2f}", "found" if track.found else "lost")
