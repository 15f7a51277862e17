//! Which pixels of a view count, at other sizes and as factors. Knows nothing of what is measured or
//! learnt.

use artifacts_schema::View;
use compute::{Array, Device};

/// The view's mask at the size of `height` rows of `width` pixels: a new pixel counts if every pixel
/// that it lies on does. `None` where all count.
pub fn at_size(view: &View, width: u32, height: u32) -> Option<Vec<bool>> {
    let mask = view.mask.as_ref()?;
    let [w, h] = [view.camera.width, view.camera.height].map(|side| side as usize);
    let columns = spans(w, width as usize);
    let rows = spans(h, height as usize);
    let counts = |row: &Span, column: &Span| {
        // One masked pixel is enough: what was mixed of it is not to be trusted.
        (row[0]..=row[1]).all(|y| (column[0]..=column[1]).all(|x| mask[y * w + x]))
    };
    let pixels = rows
        .iter()
        .flat_map(|row| columns.iter().map(move |column| counts(row, column)));
    Some(pixels.collect())
}

/// The first and the last pixel that a new one lies on.
type Span = [usize; 2];

/// Of `side` pixels, by new pixel of `new`.
fn spans(side: usize, new: usize) -> Vec<Span> {
    (0..new)
        // In whole numbers: rounding must not make a pixel touch its neighbour.
        .map(|i| [i * side / new, ((i + 1) * side - 1) / new])
        .collect()
}

/// The pixels that count in both of two masks of one size.
pub fn both(a: Option<Vec<bool>>, b: Option<Vec<bool>>) -> Option<Vec<bool>> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.iter().zip(&b).map(|(a, b)| *a && *b).collect()),
        (a, b) => a.or(b),
    }
}

/// The view's mask as [1, `channels`, H, W], 1 where a pixel counts and 0 where it is masked; `None`
/// where all count.
pub fn factors(view: &View, channels: usize, device: &Device) -> Option<Array> {
    let mask = view.mask.as_ref()?;
    let [w, h] = [view.camera.width, view.camera.height].map(|side| side as usize);
    let plane = mask.iter().map(|counts| f32::from(u8::from(*counts)));
    let planes = plane.collect::<Vec<f32>>().repeat(channels);
    Some(device.array(&[1, channels, h, w], planes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use formats::{Camera, Pixels};
    use glam::DMat4;

    fn view(mask: Vec<bool>, size: (u32, u32)) -> View {
        View {
            name: "a".into(),
            camera: Camera::centered(size, 2.0, DMat4::IDENTITY, [1.0, 4.0]),
            pixels: Pixels::opaque(vec![0.0; 3 * mask.len()]),
            depth: None,
            mask: Some(mask),
        }
    }

    #[test]
    fn enlarged_pixels_count_as_what_they_lie_on_does() {
        let small = view(vec![true, false], (2, 1));
        let large = at_size(&small, 4, 2).unwrap();
        assert_eq!(large, [true, true, false, false].repeat(2));
        let uneven = at_size(&small, 3, 1).unwrap();
        assert_eq!(uneven, [true, false, false], "the middle lies on both");
        let back = view(large, (4, 2));
        assert_eq!(at_size(&back, 2, 1), small.mask);
    }

    #[test]
    fn two_masks_leave_what_both_leave() {
        let [a, b] = [vec![true, true, false], vec![true, false, true]].map(Some);
        assert_eq!(both(a.clone(), b), Some(vec![true, false, false]));
        assert_eq!(both(a.clone(), None), a);
        assert_eq!(both(None, None), None);
    }
}
