//! Which pixels a training step looks at, and what they should be. Knows photos and cameras, and
//! nothing of the field.

use crate::mask::Mask;
use crate::train_pixels::TrainPixels;
use compute::rng::Rng;
use formats::Camera;

/// A photo to train on. Each of its pixels is the mean of the radiance over the pixel's area.
#[derive(Clone, Debug)]
pub struct TrainView {
    /// Where it was taken.
    pub camera: Camera,
    /// What was seen, 0 to 1; the field is to be as transparent.
    pub pixels: TrainPixels,
    /// Which pixels are looked at; `None` for all.
    pub mask: Option<Mask>,
    /// Factor on the squared error of every pixel of this view.
    pub weight: f32,
    /// Sub-rays per pixel and axis that are averaged to a pixel, on a grid that is turned at random;
    /// 1 is the centre.
    pub supersample: u32,
}

/// A pixel of a batch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// Index of its view.
    pub view: usize,
    /// Column, from 0 at the left.
    pub x: u32,
    /// Row, from 0 at the top.
    pub y: u32,
    /// Its number in the batch; the key of its random numbers.
    pub element: u64,
    /// The colour behind the field, and behind the photo where it is transparent.
    pub background: [f32; 3],
}

/// Draws batches that mix all views, of pixels that are not masked.
#[derive(Clone, Debug)]
pub struct Sampler {
    ends: Vec<u64>,
    rng: Rng,
}

impl Sampler {
    /// A sampler over the pixels of all views.
    pub fn new(views: &[TrainView], seed: u64) -> Self {
        let sums = views.iter().scan(0, |end, view| {
            *end += view.open();
            Some(*end)
        });
        Self {
            ends: sums.collect(),
            rng: Rng::new(seed, "training batch"),
        }
    }

    /// Pixel `element` of the `count` of a step. Each lies at a random place in its own equal share
    /// of all pixels, so that every batch covers all views evenly.
    pub fn pixel(&self, views: &[TrainView], step: u64, element: u64, count: u64) -> Pixel {
        let total = self.ends.last().copied().unwrap_or(0);
        let place = (element as f64 + f64::from(self.random(step, element, 0))) / count as f64;
        // Rounding may reach the very end.
        let index = ((place * total as f64) as u64).min(total.saturating_sub(1));
        // The first view that ends behind it, which passes over views without an open pixel.
        let view = self.ends.partition_point(|&end| end <= index);
        let inside = index - if view == 0 { 0 } else { self.ends[view - 1] };
        let inside = match &views[view].mask {
            Some(mask) => u64::from(mask.nth(inside as u32)),
            None => inside,
        };
        let width = u64::from(views[view].camera.width);
        let background = [1, 2, 3].map(|i| self.random(step, element, i));
        Pixel {
            view,
            x: (inside % width) as u32,
            y: (inside / width) as u32,
            element,
            background,
        }
    }

    /// Where in the image the sub-rays of a pixel go, with the jitter of their steps.
    ///
    /// They form an even grid with the second moment of the pixel's area, turned about the pixel's
    /// centre by a random angle. At any angle their mean is the mean over the area for every cubic
    /// polynomial. A random place in each cell has that mean only on average. The squared error
    /// includes the variance, so that training would smooth the field (docs/lab/field.md).
    pub fn sub_rays(
        &self,
        pixel: Pixel,
        side: u32,
        step: u64,
    ) -> impl Iterator<Item = (f64, f64, f32)> + '_ {
        let [cos, sin] = turn(self.random(step, pixel.element, 4));
        let distance = spacing(side);
        let middle = f64::from(side - 1) / 2.0;
        let [x, y] = [pixel.x, pixel.y].map(|corner| f64::from(corner) + 0.5);
        (0..side * side).map(move |sub| {
            let across = distance * (f64::from(sub % side) - middle);
            let down = distance * (f64::from(sub / side) - middle);
            (
                x + cos * across - sin * down,
                y + sin * across + cos * down,
                self.random(step, pixel.element, 5 + u64::from(sub)),
            )
        })
    }

    /// Random number `i` of a pixel: 1024 are set aside for each, enough for 16 x 16 sub-rays.
    fn random(&self, step: u64, element: u64, i: u64) -> f32 {
        self.rng.uniform(step, element * 1024 + i)
    }
}

/// Distance of neighbours in a grid of `side` x `side` points that has the second moment of the unit
/// square, 1/12 along each axis; the middles of its cells have (1 - 1/side^2) / 12.
fn spacing(side: u32) -> f64 {
    let side = f64::from(side);
    if side > 1.0 {
        1.0 / (side * side - 1.0).sqrt()
    } else {
        0.0
    }
}

/// Cosine and sine of a random angle of -45 to 45 degrees, beyond which a square grid repeats. The
/// tangent of half the angle is uniform. Sines and cosines of a platform's library would differ in
/// their last bits from platform to platform. Angles near 45 degrees come a sixth more often than
/// those near 0.
fn turn(random: f32) -> [f64; 2] {
    let most = std::f64::consts::SQRT_2 - 1.0;
    let tangent = most * (2.0 * f64::from(random) - 1.0);
    let square = tangent * tangent;
    [1.0 - square, 2.0 * tangent].map(|side| side / (1.0 + square))
}

impl TrainView {
    /// How many pixels are looked at.
    pub fn open(&self) -> u64 {
        match &self.mask {
            Some(mask) => u64::from(mask.open()),
            None => u64::from(self.camera.width) * u64::from(self.camera.height),
        }
    }

    /// Sub-rays of a pixel.
    pub(crate) fn rays_per_pixel(&self) -> usize {
        self.supersample as usize * self.supersample as usize
    }

    /// What a pixel should be in front of a background.
    pub fn target(&self, pixel: &Pixel) -> [f32; 3] {
        let at = pixel.y as usize * self.camera.width as usize + pixel.x as usize;
        let (color, alpha) = self.pixels.pixel(at);
        std::array::from_fn(|c| alpha * color[c] + (1.0 - alpha) * pixel.background[c])
    }

    /// Panics if the sizes do not fit together: views are checked where they are read.
    pub(crate) fn check(&self) {
        let pixels = self.camera.width as usize * self.camera.height as usize;
        self.pixels.check(pixels);
        assert!(
            self.mask
                .as_ref()
                .is_none_or(|mask| mask.pixels() == pixels),
            "a training view's mask does not fit"
        );
        assert!(
            (1..=16).contains(&self.supersample),
            "a training view's supersample is not 1 to 16"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use formats::Pixels;
    use glam::DMat4;

    fn view(width: u32, height: u32) -> TrainView {
        let camera = Camera::centered(
            (width, height),
            f64::from(width),
            DMat4::IDENTITY,
            [1.0, 2.0],
        );
        TrainView {
            camera,
            pixels: Pixels::opaque(vec![0.25; (3 * width * height) as usize]).into(),
            mask: None,
            weight: 1.0,
            supersample: 2,
        }
    }

    #[test]
    fn a_batch_covers_all_views_in_proportion_to_their_pixels() {
        let views = [view(8, 4), view(16, 8)];
        let sampler = Sampler::new(&views, 1);
        let mut counts = [0; 2];
        for element in 0..100 {
            let pixel = sampler.pixel(&views, 3, element, 100);
            counts[pixel.view] += 1;
            assert!(
                pixel.x < views[pixel.view].camera.width
                    && pixel.y < views[pixel.view].camera.height
            );
        }
        assert_eq!(counts, [20, 80]);
    }

    #[test]
    fn as_many_elements_as_pixels_take_each_once() {
        let views = [view(8, 4), view(16, 8)];
        let sampler = Sampler::new(&views, 1);
        let mut seen: Vec<_> = (0..160)
            .map(|e| sampler.pixel(&views, 0, e, 160))
            .map(|p| (p.view, p.y, p.x))
            .collect();
        seen.dedup();
        assert_eq!(seen.len(), 160);
    }

    #[test]
    fn masked_pixels_are_never_drawn() {
        let mut views = [view(8, 4), view(16, 8)];
        let open: Vec<bool> = (0..128).map(|i| i % 4 == 3).collect();
        views[1].mask = Some(Mask::new(&open));
        let sampler = Sampler::new(&views, 1);
        let mut counts = [0; 2];
        for element in 0..64 {
            let pixel = sampler.pixel(&views, 3, element, 64);
            counts[pixel.view] += 1;
            assert!(pixel.view == 0 || pixel.x % 4 == 3, "{pixel:?}");
        }
        assert_eq!(counts, [32, 32]);
    }

    #[test]
    fn the_mean_over_sub_rays_is_exact_for_cubic_polynomials() {
        let views = [view(8, 4)];
        let sampler = Sampler::new(&views, 1);
        // The mean of x^i y^j over a unit square about 0.
        let means = [
            ((0, 0), 1.0),
            ((1, 0), 0.0),
            ((0, 1), 0.0),
            ((2, 0), 1.0 / 12.0),
            ((1, 1), 0.0),
            ((0, 2), 1.0 / 12.0),
            ((3, 0), 0.0),
            ((2, 1), 0.0),
            ((1, 2), 0.0),
            ((0, 3), 0.0),
        ];
        for element in 0..32 {
            let pixel = sampler.pixel(&views, 0, element, 32);
            let [x, y] = [pixel.x, pixel.y].map(|corner| f64::from(corner) + 0.5);
            for side in [2, 3, 5] {
                let rays: Vec<_> = sampler.sub_rays(pixel, side, 0).collect();
                for ((i, j), mean) in means {
                    let power = |(px, py, _): &(f64, f64, f32)| (px - x).powi(i) * (py - y).powi(j);
                    let sum: f64 = rays.iter().map(power).sum();
                    let off = sum / f64::from(side * side) - mean;
                    assert!(
                        off.abs() < 1e-12,
                        "x^{i} y^{j}, {side} a side: off by {off}"
                    );
                }
            }
        }
    }

    #[test]
    fn sub_rays_turn_from_pixel_to_pixel_and_step_to_step() {
        let views = [view(8, 4)];
        let sampler = Sampler::new(&views, 1);
        let first = |element: u64, step: u64| {
            let pixel = sampler.pixel(&views, step, element, 32);
            let (x, y, _) = sampler.sub_rays(pixel, 2, step).next().unwrap();
            (x - f64::from(pixel.x), y - f64::from(pixel.y))
        };
        let [here, there, later] = [first(5, 0), first(6, 0), first(5, 1)];
        assert!(
            here != there && here != later,
            "{here:?} {there:?} {later:?}"
        );
        for (x, y) in [here, there, later] {
            assert!(
                (0.0..1.0).contains(&x) && (0.0..1.0).contains(&y),
                "({x}, {y})"
            );
        }
    }

    #[test]
    fn a_single_ray_goes_through_the_centre() {
        let views = [view(8, 4)];
        let sampler = Sampler::new(&views, 1);
        let pixel = sampler.pixel(&views, 0, 5, 32);
        let (x, y, _) = sampler.sub_rays(pixel, 1, 0).next().unwrap();
        assert_eq!((x, y), (f64::from(pixel.x) + 0.5, f64::from(pixel.y) + 0.5));
    }

    #[test]
    fn a_transparent_photo_shows_the_background() {
        let mut photo = view(8, 4);
        let pixel = Pixel {
            view: 0,
            x: 1,
            y: 0,
            element: 0,
            background: [1.0, 0.5, 0.0],
        };
        assert_eq!(photo.target(&pixel), [0.25; 3]);
        photo.pixels = Pixels::new(vec![0.25; 96], Some(vec![0.0; 32])).into();
        assert_eq!(photo.target(&pixel), [1.0, 0.5, 0.0]);
    }
}
