//! The stage kinds, one file each; what only one of them needs lies in a folder of its name. Knows
//! nothing of pipelines: the registry lists the kinds.

pub mod blend;
pub mod decode;
pub mod encode;
pub mod evaluate;
pub mod film;
pub mod fit;
pub mod interpolate;
pub mod optimize;
pub mod render;
pub mod scene;
pub mod sync;
