//! The colours that splats begin with: for each the harmonics that come nearest to what the pictures
//! show of it, by least squares. Knows no rasteriser.

use formats::Camera;
use glam::Vec3;
use rayon::prelude::*;

use crate::cloud::Cloud;
use crate::harmonics::{self, MOST};
use crate::picture::Picture;

/// A splat is hidden where the surface lies in front of it by more than this part of its depth.
const HIDDEN: f32 = 0.03;
/// How much a coefficient of some degree is held towards none, in pictures: few cameras tell little
/// of directions.
const HOLD: [f32; 3] = [1e-3, 1.0, 2.0];

/// Sums over the views that were added.
pub struct Colors {
    sums: Vec<Sums>,
}

/// The normal equations of one splat: half of a symmetric matrix, and a side for each channel.
#[derive(Clone)]
struct Sums {
    matrix: [[f32; MOST]; MOST],
    side: [[f32; 3]; MOST],
}

impl Colors {
    /// No view has been added yet.
    pub fn new(cloud: &Cloud) -> Self {
        let none = Sums {
            matrix: [[0.0; MOST]; MOST],
            side: [[0.0; 3]; MOST],
        };
        Self {
            sums: vec![none; cloud.splats.len()],
        }
    }

    /// Adds what one view says of the colours. `depth` is along the view axis; splats that it shows
    /// to be hidden get nothing.
    pub fn add_view(&mut self, cloud: &Cloud, camera: &Camera, picture: &Picture, depth: &[f32]) {
        let coefficients = cloud.coefficients();
        let eye = camera.position().as_vec3();
        let sums = self.sums.par_iter_mut().zip(&cloud.splats);
        sums.for_each(|(sums, splat)| {
            let Some(color) = seen(camera, picture, depth, splat.position) else {
                return;
            };
            let values = harmonics::values((splat.position - eye).normalize_or(Vec3::Z));
            sums.add(&values[..coefficients], color);
        });
    }

    /// Gives the splats their colours.
    pub fn settle(self, cloud: &mut Cloud) {
        let coefficients = cloud.coefficients();
        let splats = cloud.splats.par_iter_mut().zip(self.sums);
        splats.for_each(|(splat, sums)| splat.harmonics = sums.solve(coefficients));
    }
}

/// The colour of the pixel that shows a point, without what is seen through it; `None` if the point
/// is hidden or beside the picture.
fn seen(camera: &Camera, picture: &Picture, depth: &[f32], point: Vec3) -> Option<[f32; 3]> {
    let [px, py, distance] = camera.project(point.to_array().map(f64::from))?;
    // Pixel (x, y) spans x..x + 1, so the whole part of a position is its pixel.
    let inside =
        px >= 0.0 && py >= 0.0 && px < f64::from(camera.width) && py < f64::from(camera.height);
    let index = inside.then(|| py as usize * camera.width as usize + px as usize)?;
    let [r, g, b, covered] = picture.pixels[index];
    let is_hidden = distance as f32 > depth[index] * (1.0 + HIDDEN);
    // Pictures are times coverage; divided, what shines through is left out.
    (!is_hidden && covered > 0.5).then(|| [r, g, b].map(|channel| channel / covered))
}

impl Sums {
    fn add(&mut self, values: &[f32], color: [f32; 3]) {
        // Half of the matrix is enough: it is symmetric, and Cholesky reads the lower triangle.
        for (i, a) in values.iter().enumerate() {
            for (j, b) in values[..=i].iter().enumerate() {
                self.matrix[i][j] += a * b;
            }
            for (sum, channel) in self.side[i].iter_mut().zip(color) {
                // Harmonics add to a middle grey.
                *sum += a * (channel - 0.5);
            }
        }
    }

    /// Solves them by Cholesky's decomposition; the hold makes the matrix positive.
    fn solve(mut self, count: usize) -> [[f32; 3]; MOST] {
        for i in 0..count {
            // The functions of degree d begin at number d^2.
            let degree = (i as f32).sqrt() as usize;
            // In pictures, since one picture adds the square of FLAT to the first of the diagonal.
            self.matrix[i][i] += HOLD[degree] * harmonics::FLAT * harmonics::FLAT;
        }
        decompose(&mut self.matrix, count);
        let column =
            |channel: usize| substitute(&self.matrix, &self.side.map(|s| s[channel]), count);
        let [red, green, blue] = [0, 1, 2].map(column);
        std::array::from_fn(|i| [red[i], green[i], blue[i]])
    }
}

/// The lower triangle whose product with itself, turned over, is the matrix; in its place.
fn decompose(lower: &mut [[f32; MOST]; MOST], count: usize) {
    for i in 0..count {
        for j in 0..=i {
            let done: f32 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let rest = lower[i][j] - done;
            lower[i][j] = match i == j {
                // Rounding can bring a pivot to 0 or below, whose root would spoil all colours.
                true => rest.max(f32::MIN_POSITIVE).sqrt(),
                false => rest / lower[j][j],
            };
        }
    }
}

/// Forwards through the triangle, and back through it turned over.
fn substitute(lower: &[[f32; MOST]; MOST], side: &[f32; MOST], count: usize) -> [f32; MOST] {
    let mut solved = [0.0; MOST];
    for i in 0..count {
        let done: f32 = (0..i).map(|k| lower[i][k] * solved[k]).sum();
        solved[i] = (side[i] - done) / lower[i][i];
    }
    for i in (0..count).rev() {
        let done: f32 = (i + 1..count).map(|k| lower[k][i] * solved[k]).sum();
        solved[i] = (solved[i] - done) / lower[i][i];
    }
    solved
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_that_turns_with_the_direction_is_found() {
        let mut truth = [[0.0; 3]; MOST];
        truth[0] = [0.5, -0.2, 0.1];
        truth[2] = [0.3, 0.0, -0.1];
        let none = Cloud {
            splats: Vec::new(),
            degree: 1,
        };
        let mut sums = Sums {
            matrix: [[0.0; MOST]; MOST],
            side: [[0.0; 3]; MOST],
        };
        for i in 0..4000 {
            let angle = i as f32 * 0.1;
            let direction = Vec3::new(angle.cos(), angle.sin(), (i as f32).sin()).normalize();
            let values = harmonics::values(direction);
            sums.add(&values[..4], harmonics::color(&truth[..4], &values));
        }
        let solved = sums.solve(none.coefficients());
        for (solved, truth) in solved.iter().zip(truth) {
            for (a, b) in solved.iter().zip(truth) {
                assert!((a - b).abs() < 5e-3, "{solved:?} {truth:?}");
            }
        }
    }
}
