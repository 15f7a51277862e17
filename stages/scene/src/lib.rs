//! Cameras and their conventions, readers of posed photos, and procedural scenes.
