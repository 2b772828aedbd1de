"""Track a box through a video: `python examples/track_video.py clip.mp4 309,192,22,48`."""

import sys

import racf

path, box = sys.argv[1:] if len(sys.argv) == 3 else sys.exit("usage: track_video.py VIDEO x,y,w,h")
try:
    racf.one_core()
    images, tracker = racf.Video(path).images(), racf.Racf("racf,robust")
    tracker.init(next(images).image, racf.Box.parse(box))  # x,y,w,h in the first image
    for shown in images:
        track = tracker.update(shown.image)
        print(f"{shown.t_s:.3f}", track.box, f"{track.confidence:.2f}", "found" if track.found else "lost")
except ValueError as error:
    sys.exit(f"track_video.py: {error}")
