"""Track a box through a video: `python examples/track_video.py clip.mp4 309,192,22,48`."""

import sys

import racf

racf.one_core()
images, tracker = racf.Video(sys.argv[1]).images(), racf.Racf("racf,robust")
tracker.init(next(images).image, racf.Box.parse(sys.argv[2]))  # x,y,w,h in the first image
for shown in images:
    track = tracker.update(shown.image)
    print(f"{shown.t_s:.3f}", track.box, f"{track.confidence:.2f}", "found" if track.found else "lost")
