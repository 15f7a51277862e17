//! Shards: a stage that works view by view, computed in parts that do not see each other's views.
//! Knows no stage.

use artifacts_schema::{StoredImages, StoredLatents};

use crate::convert::in_range;
use crate::error::StageError;
use crate::registry::AnyStage;
use crate::size::{Size, Sizes};

/// More parts than this are taken for a mistake.
const MOST: u32 = 1024;

/// Some of a stage's views: of each row of `of` views, the one at `index`. So every part sees the
/// scene from all around.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Which part, from 0.
    pub index: usize,
    /// How many parts there are.
    pub of: usize,
}

impl Shard {
    /// The part that a stage's fields name: `shard` counts from 1, and 0 stands for all views.
    pub fn new(shards: u32, shard: u32) -> Self {
        match shard {
            0 => Self { index: 0, of: 1 },
            _ => Self {
                index: shard as usize - 1,
                of: shards as usize,
            },
        }
    }

    /// This part of the views; an error if it has none.
    pub fn take<V>(&self, views: Vec<V>) -> Result<Vec<V>, StageError> {
        let all = views.len();
        let taken: Vec<V> = views
            .into_iter()
            // Neighbours in the list are often neighbours in space; strides deal them out to all
            // parts.
            .skip(self.index)
            .step_by(self.of)
            .collect();
        match (taken.len(), self.of) {
            (0, 2..) => Err(StageError::Mismatch(format!(
                "`shards` is {}, but there are only {all} views",
                self.of
            ))),
            _ => Ok(taken),
        }
    }

    /// This part of stored images; an error if it has none. Pixels of the others are never read.
    pub fn images(&self, images: StoredImages) -> Result<StoredImages, StageError> {
        let places = self.take((0..images.cameras().len()).collect())?;
        Ok(images.only(&places))
    }

    /// This part of stored latents; an error if it has none. Numbers of the others are never read.
    pub fn latents(&self, latents: StoredLatents) -> Result<StoredLatents, StageError> {
        let places = self.take((0..latents.heads().views.len()).collect())?;
        Ok(latents.only(&places))
    }

    /// How large this part of something is, at most.
    pub fn size(&self, whole: Size) -> Size {
        let of = self.of as u64;
        let views = whole.views.div_ceil(of);
        let all = match whole.pixels {
            0 => whole.bytes,
            pixels => pixels,
        };
        let share = match views {
            // Who does not know its views can only share out what they have together.
            0 => 1.0 / self.of as f64,
            // A part may have got the largest.
            _ => (views * whole.largest) as f64 / all as f64,
        };
        let part = |number: u64| (number as f64 * share.min(1.0)).ceil() as u64;
        Size {
            bytes: part(whole.bytes),
            pixels: part(whole.pixels),
            views,
            ..whole
        }
    }

    /// How large this part of the images and latents among the inputs is, at most. Whatever else
    /// there is each part reads whole.
    pub fn sizes<'a>(&self, inputs: &Sizes<'a>) -> Sizes<'a> {
        let part = |size: Size| match size.largest {
            0 => size,
            _ => self.size(size),
        };
        let inputs = inputs.iter();
        inputs.map(|(name, size)| (*name, part(*size))).collect()
    }
}

/// Refuses fields that name no part.
pub fn check(shards: u32, shard: u32) -> Result<(), StageError> {
    in_range("shards", shards, 1, MOST)?;
    in_range("shard", shard, 0, shards)
}

/// The stages that compute the parts; none where the stage is computed as a whole, or is a part
/// itself.
pub fn parts(shards: u32, shard: u32, part: impl Fn(u32) -> AnyStage) -> Vec<AnyStage> {
    if shards > 1 && shard == 0 {
        (1..=shards).map(part).collect()
    } else {
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_all_views_each_once() {
        let part = |shard| Shard::new(3, shard).take((0..7).collect()).unwrap();
        assert_eq!(
            (part(1), part(2), part(3)),
            (vec![0, 3, 6], vec![1, 4], vec![2, 5])
        );
        assert_eq!(part(0), (0..7).collect::<Vec<_>>());
    }

    #[test]
    fn a_part_is_as_large_as_its_views_may_be() {
        let whole = Size::of_images([(4, 4), (2, 2), (2, 2)], Some(2400));
        let part = Shard::new(2, 1).size(whole);
        assert_eq!((part.views, part.pixels, part.bytes), (2, 24, 2400));
        let part = Shard::new(3, 1).size(whole);
        assert_eq!((part.views, part.pixels, part.bytes), (1, 16, 1600));
        assert_eq!(Shard::new(3, 0).size(whole), whole);
        let latents = Shard::new(2, 1).size(Size::of_latents(Some(vec![30, 30, 30]), 100));
        assert_eq!((latents.views, latents.pixels, latents.bytes), (2, 0, 60));
    }

    #[test]
    fn a_part_without_views_is_refused() {
        let error = Shard::new(9, 9).take(vec![0; 7]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "`shards` is 9, but there are only 7 views"
        );
        assert!(check(3, 4).is_err() && check(0, 0).is_err() && check(3, 3).is_ok());
    }
}
