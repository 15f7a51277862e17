//! Splats in an image, square by square, each pixel from front to back: forward, and backward to
//! the splats' ellipses. Knows no files and no fitting.

use formats::Camera;
use glam::Vec2;
use rayon::prelude::*;

use crate::cloud::Cloud;
use crate::picture::Picture;
use crate::project::{ByEllipse, BySplat, DENSEST, Ellipse, Eye, FAINTEST};
use crate::tiles::Tiles;

/// Behind a pixel that lets no more than this through nothing is drawn.
const DARK: f32 = 1e-4;

/// What one splat does to one pixel.
struct Touch {
    /// Its place in the square's list.
    place: usize,
    alpha: f32,
    /// The Gaussian itself, from 0 to 1.
    weight: f32,
    /// From the pixel to its middle.
    offset: Vec2,
    /// What is let through before it.
    through: f32,
}

/// What a camera sees of splats, without its lens.
pub fn render(cloud: &Cloud, camera: &Camera) -> Picture {
    let tiles = Tiles::new(cloud, camera);
    let mut pixels = vec![[0.0; 4]; camera.width as usize * camera.height as usize];
    // Squares are computed side by side and put in place in order.
    let drawn: Vec<Vec<[f32; 4]>> = (0..tiles.lists.len())
        .into_par_iter()
        .map(|i| draw_tile(&tiles, i, camera.width))
        .collect();
    for (i, colors) in drawn.into_iter().enumerate() {
        for ((pixel, _), color) in tiles.tile(i).pixels(camera.width).zip(colors) {
            pixels[pixel] = color;
        }
    }
    Picture { pixels }
}

fn draw_tile(tiles: &Tiles, index: usize, width: u32) -> Vec<[f32; 4]> {
    let list = ellipses(tiles, index);
    let mut touches = Vec::new();
    let pixels = tiles.tile(index).pixels(width);
    pixels
        .map(|(_, at)| pixel(&list, at, &mut touches))
        .collect()
}

/// The squared error of a cloud's picture, halved and summed over pixels and channels, coverage
/// among them; and its derivative by every splat.
pub fn error_backward(cloud: &Cloud, camera: &Camera, truth: &Picture) -> (f64, Vec<BySplat>) {
    let tiles = Tiles::new(cloud, camera);
    let parts: Vec<(f64, Vec<ByEllipse>)> = (0..tiles.lists.len())
        .into_par_iter()
        .map(|i| tile_backward(&tiles, i, camera.width, truth))
        .collect();
    let mut error = 0.0;
    let mut by_ellipses = vec![ByEllipse::default(); cloud.splats.len()];
    // Square after square: a sum has one order.
    for (list, (part, by)) in tiles.lists.iter().zip(parts) {
        error += part;
        for (splat, by) in list.iter().zip(&by) {
            by_ellipses[*splat as usize].add(by);
        }
    }
    let eye = Eye::new(camera);
    let coefficients = cloud.coefficients();
    // Most splats lie outside of one picture.
    let backward = |(splat, by)| match by == &ByEllipse::default() {
        true => BySplat::default(),
        false => eye.project_backward(splat, coefficients, by),
    };
    let splats = cloud.splats.par_iter().zip(&by_ellipses);
    (error, splats.map(backward).collect())
}

fn tile_backward(
    tiles: &Tiles,
    index: usize,
    width: u32,
    truth: &Picture,
) -> (f64, Vec<ByEllipse>) {
    let list = ellipses(tiles, index);
    let mut by = vec![ByEllipse::default(); list.len()];
    let mut touches = Vec::new();
    let mut error = 0.0;
    for (i, at) in tiles.tile(index).pixels(width) {
        let color = pixel(&list, at, &mut touches);
        let wanted = truth.pixels[i];
        let apart: [f32; 4] = std::array::from_fn(|channel| color[channel] - wanted[channel]);
        error += apart.iter().map(|x| 0.5 * f64::from(x * x)).sum::<f64>();
        pixel_backward(&list, &touches, apart, &mut by);
    }
    (error, by)
}

fn ellipses(tiles: &Tiles, index: usize) -> Vec<Ellipse> {
    let list = &tiles.lists[index];
    list.iter()
        .filter_map(|splat| tiles.ellipses[*splat as usize])
        .collect()
}

/// A pixel's colour and coverage in front of black, and what each splat did to it.
fn pixel(list: &[Ellipse], at: Vec2, touches: &mut Vec<Touch>) -> [f32; 4] {
    touches.clear();
    let mut color = [0.0; 4];
    let mut through = 1.0;
    for (place, ellipse) in list.iter().enumerate() {
        let offset = ellipse.center - at;
        let Some((alpha, weight)) = alpha(ellipse, offset) else {
            continue;
        };
        let share = alpha * through;
        for (sum, part) in color.iter_mut().zip(opaque(ellipse)) {
            *sum += share * part;
        }
        touches.push(Touch {
            place,
            alpha,
            weight,
            offset,
            through,
        });
        through *= 1.0 - alpha;
        // What lies behind changes about a fortieth of an 8-bit step at most.
        if through < DARK {
            break;
        }
    }
    color
}

/// How opaque an ellipse is at an offset from its middle, and its Gaussian there; `None` where it is
/// too faint.
fn alpha(ellipse: &Ellipse, offset: Vec2) -> Option<(f32, f32)> {
    let [xx, xy, yy] = ellipse.conic;
    let square =
        xx * offset.x * offset.x + 2.0 * xy * offset.x * offset.y + yy * offset.y * offset.y;
    let weight = (-0.5 * square).exp();
    let alpha = (ellipse.opacity * weight).min(DENSEST);
    (alpha >= FAINTEST).then_some((alpha, weight))
}

/// Colour and coverage of a splat where nothing is seen through it.
fn opaque(ellipse: &Ellipse) -> [f32; 4] {
    let [r, g, b] = ellipse.color;
    [r, g, b, 1.0]
}

/// Adds the derivative by all that touched a pixel, from that by its colour.
fn pixel_backward(list: &[Ellipse], touches: &[Touch], by_color: [f32; 4], by: &mut [ByEllipse]) {
    // What all that lies behind adds, as seen from right behind the splat.
    // From back to front, so that each splat finds what lies behind it summed up.
    let mut behind = [0.0; 4];
    for touch in touches.iter().rev() {
        let ellipse = &list[touch.place];
        let by = &mut by[touch.place];
        let color = opaque(ellipse);
        let share = touch.alpha * touch.through;
        let mut by_alpha = 0.0;
        for channel in 0..4 {
            // C = T (alpha c + (1 - alpha) behind), so dC/dalpha = T (c - behind).
            by_alpha += by_color[channel] * touch.through * (color[channel] - behind[channel]);
            behind[channel] = touch.alpha * color[channel] + (1.0 - touch.alpha) * behind[channel];
        }
        for (sum, by_color) in by.color.iter_mut().zip(by_color) {
            *sum += share * by_color;
        }
        // At DENSEST it is held and does not follow the opacity.
        if touch.alpha < DENSEST {
            alpha_backward(ellipse, touch, by_alpha, by);
        }
    }
}

/// The derivative through [`alpha`].
fn alpha_backward(ellipse: &Ellipse, touch: &Touch, by_alpha: f32, by: &mut ByEllipse) {
    by.opacity += touch.weight * by_alpha;
    let by_square = -0.5 * ellipse.opacity * touch.weight * by_alpha;
    let Vec2 { x, y } = touch.offset;
    by.conic[0] += by_square * x * x;
    // Half of 2 x y; the other half is that of the equal number across the diagonal.
    by.conic[1] += by_square * x * y;
    by.conic[2] += by_square * y * y;
}

impl ByEllipse {
    fn add(&mut self, other: &Self) {
        let pairs = self.conic.iter_mut().zip(other.conic);
        pairs.for_each(|(sum, part)| *sum += part);
        let pairs = self.color.iter_mut().zip(other.color);
        pairs.for_each(|(sum, part)| *sum += part);
        self.opacity += other.opacity;
    }
}

#[cfg(test)]
mod tests;
