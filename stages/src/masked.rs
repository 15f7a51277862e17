//! Figures of images of which some pixels are masked and do not count. Knows no metric but how it
//! is put together.

use std::collections::BTreeMap;

/// Figures of a whole image whose masked pixels are those of the truth, as figures of the others
/// alone.
///
/// A squared error there is 0 and a similarity 1: means over all pixels become means over those
/// that count. A figure that is no such mean, as of an image without a truth, is left out.
pub fn counted(figures: BTreeMap<String, f64>, mask: Option<&[bool]>) -> BTreeMap<String, f64> {
    let Some(mask) = mask else {
        return figures;
    };
    let open = mask.iter().filter(|counts| **counts).count();
    // The part of the pixels that counts.
    let part = open as f64 / mask.len().max(1) as f64;
    let figure = |(name, value): (String, f64)| {
        let value = match name.as_str() {
            _ if open == 0 => return None,
            name if name.starts_with("psnr") => value + 10.0 * part.log10(),
            name if name.starts_with("ssim") => 1.0 - (1.0 - value) / part,
            _ => return None,
        };
        Some((name, value))
    };
    figures.into_iter().filter_map(figure).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masked_pixels_change_no_figure() {
        // Half of the pixels are off by 0.1, the others masked: 20 dB, where the whole image has
        // 23.
        let mask = [true, false];
        let whole = BTreeMap::from([
            ("psnr_hr".to_owned(), -10.0 * (0.5 * 0.01_f64).log10()),
            ("ssim_hr".to_owned(), 0.9),
            ("niqe_y".to_owned(), 5.0),
        ]);
        let counted = counted(whole.clone(), Some(&mask));
        assert!((counted["psnr_hr"] - 20.0).abs() < 1e-9);
        assert!((counted["ssim_hr"] - 0.8).abs() < 1e-9);
        assert!(!counted.contains_key("niqe_y"), "it has no truth");
        assert_eq!(super::counted(whole.clone(), None), whole);
        assert!(super::counted(whole, Some(&[false])).is_empty());
    }
}
