"""The steps from photos to poses, as `src/import/tool.rs` asks for them: FOLDER STEP [LENS MODE | BLOCK]."""
import sys
from pathlib import Path

import pycolmap

work, step = Path(sys.argv[1]), sys.argv[2]
database, images, sparse = work / "database.db", work / "images", work / "sparse"
if step == "features":
    reading = pycolmap.ImageReaderOptions()
    reading.camera_model = sys.argv[3]
    mode = getattr(pycolmap.CameraMode, sys.argv[4])
    pycolmap.extract_features(database, images, camera_mode=mode, reader_options=reading)
elif step == "matches":
    options = {}
    if hasattr(pycolmap, "ExhaustivePairingOptions"):
        pairing = pycolmap.ExhaustivePairingOptions()
        pairing.block_size = int(sys.argv[3])
        options = {"pairing_options": pairing}
    pycolmap.match_exhaustive(database, **options)
elif step == "matches_in_time":
    pycolmap.match_sequential(database)
elif step == "global_poses":
    pycolmap.global_mapping(database, images, sparse)
else:
    pycolmap.incremental_mapping(database, images, sparse)
