//! Scores of images of which some pixels are masked and do not count. Knows no metric but how it is
//! put together.

use super::scores::Scored;

/// Scores of a whole image whose masked pixels are those of the truth, as scores of the others
/// alone.
///
/// A squared error there is 0, a similarity 1, a FLIP 0: means over all pixels become means over
/// those that count. A score that is no such mean, as of an image without a truth, is absent.
pub fn counted(scores: Vec<Scored>, mask: Option<&[bool]>) -> Vec<Scored> {
    let Some(mask) = mask else {
        return scores;
    };
    let open = mask.iter().filter(|counts| **counts).count();
    // The part of the pixels that counts.
    let part = open as f64 / mask.len().max(1) as f64;
    let score = |(name, value): Scored| {
        let value = value.and_then(|value| match name {
            _ if open == 0 => Err("every pixel is masked".to_owned()),
            // The squared error of those that count is that of all over `part`.
            name if name.starts_with("psnr") => Ok(value + 10.0 * part.log10()),
            // 1 - SSIM is what is 0 at masked pixels, so that it is what is divided.
            name if name.starts_with("ssim_") => Ok(1.0 - (1.0 - value) / part),
            name if name.starts_with("flip") => Ok(value / part),
            _ => Err("parts of the photo are masked, and it is no mean over pixels".to_owned()),
        });
        (name, value)
    };
    scores.into_iter().map(score).collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn masked_pixels_change_no_score() {
        // Half of the pixels are off by 0.1, the others masked: 20 dB, where the whole image has
        // 23.
        let mask = [true, false];
        let whole = vec![
            ("psnr_hr", Ok(-10.0 * (0.5 * 0.01_f64).log10())),
            ("ssim_hr", Ok(0.9)),
            ("flip_hr", Ok(0.1)),
            ("niqe_y", Ok(5.0)),
        ];
        let counted: Vec<_> = super::counted(whole.clone(), Some(&mask));
        let value = |i: usize| counted[i].1.clone().unwrap();
        assert!((value(0) - 20.0).abs() < 1e-9);
        assert!((value(1) - 0.8).abs() < 1e-9);
        assert!((value(2) - 0.2).abs() < 1e-9);
        assert!(counted[3].1.is_err(), "it has no truth");
        assert_eq!(super::counted(whole.clone(), None), whole);
        assert!(
            super::counted(whole, Some(&[false]))
                .iter()
                .all(|score| score.1.is_err())
        );
    }
}
