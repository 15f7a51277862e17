//! The parts of pictures in which arms differ most from each other. Knows only pixels.

use super::gallery::Gallery;

/// A square part of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct Crop {
    pub view: usize,
    /// Its left column.
    pub left: usize,
    /// Its top row.
    pub top: usize,
    /// Its side in pixels.
    pub side: usize,
    /// How much arms differ in it.
    difference: f64,
}

/// The parts in which arms differ most, the most telling first, none over another.
pub fn telling(gallery: &Gallery, count: usize) -> Vec<Crop> {
    let mut all: Vec<Crop> = (0..gallery.views.len())
        .flat_map(|view| of_view(gallery, view))
        .collect();
    // The sort is stable, so of equal windows the first view's comes first each time.
    all.sort_by(|a, b| b.difference.total_cmp(&a.difference));
    let mut chosen: Vec<Crop> = Vec::new();
    for crop in all {
        if chosen.len() < count && crop.difference > 0.0 && !chosen.iter().any(|c| c.touches(&crop))
        {
            chosen.push(crop);
        }
    }
    chosen
}

impl Crop {
    fn touches(&self, other: &Self) -> bool {
        let near = |a: usize, b: usize| a.abs_diff(b) < self.side.max(other.side);
        self.view == other.view && near(self.left, other.left) && near(self.top, other.top)
    }
}

/// Windows of a fifth of the height, half over each other.
fn of_view(gallery: &Gallery, view: usize) -> Vec<Crop> {
    let pictures: Vec<_> = (0..gallery.arms())
        .filter_map(|arm| gallery.render(arm, view))
        .map(|shown| &shown.picture)
        .collect();
    let Some(first) = pictures.first() else {
        return Vec::new();
    };
    let width = first.width as usize;
    let height = first.height as usize;
    // Arms may enlarge by different factors. Only pictures of one size can be compared pixel by
    // pixel.
    let alike: Vec<&[u8]> = pictures
        .iter()
        .filter(|picture| picture.rgb8.len() == first.rgb8.len())
        .map(|picture| picture.rgb8.as_slice())
        .collect();
    let variance: Vec<f64> = (0..width * height).map(|at| variance(&alike, at)).collect();
    // At most the picture itself: `height - side` below must not wrap around.
    let side = (height / 5).clamp(8, 256).min(width).min(height);
    // Half over each other, so that what is telling is not cut in two by the raster.
    let step = (side / 2).max(1);
    let tops = (0..=height - side).step_by(step);
    let windows = tops.flat_map(|top| {
        (0..=width - side)
            .step_by(step)
            .map(move |left| (left, top))
    });
    windows
        .map(|(left, top)| {
            let rows = (top..top + side).map(|y| &variance[y * width + left..][..side]);
            Crop {
                view,
                left,
                top,
                side,
                difference: rows.flatten().sum(),
            }
        })
        .collect()
}

/// How much pictures differ from each other in a pixel: the variance of its brightness.
fn variance(pictures: &[&[u8]], at: usize) -> f64 {
    let value = |rgb8: &&[u8]| {
        rgb8[3 * at..3 * at + 3]
            .iter()
            .map(|v| f64::from(*v))
            .sum::<f64>()
    };
    let count = pictures.len() as f64;
    let mean = pictures.iter().map(value).sum::<f64>() / count;
    let squares = pictures.iter().map(|rgb8| (value(rgb8) - mean).powi(2));
    squares.sum::<f64>() / count
}
