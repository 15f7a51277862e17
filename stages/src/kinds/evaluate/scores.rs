//! Scores as they are collected, row by row and view by view, and why some are missing. Knows
//! nothing of how pictures come about.

use std::collections::BTreeMap;

use artifacts_schema::{Metrics, Row};
use metrics::Image;

/// A metric's value, or why there is none.
pub type Scored = (&'static str, Result<f64, String>);

/// Scores by row, view and metric, and which are missing.
#[derive(Default)]
pub struct Scores {
    rows: BTreeMap<String, BTreeMap<String, BTreeMap<String, f64>>>,
    missing: BTreeMap<String, BTreeMap<String, Missing>>,
    /// The fewest blocks that NIQE had of any picture.
    blocks: Option<usize>,
}

/// A metric that some views of a row lack.
struct Missing {
    views: usize,
    why: String,
}

/// How many blocks NIQE needs for statistics of full rank.
// The covariance of 36 features has full rank with at least 37 blocks.
const BLOCKS: usize = 37;

impl Scores {
    /// Adds what a view scores in a row.
    pub fn add(&mut self, row: &str, view: &str, scores: impl IntoIterator<Item = Scored>) {
        for (metric, score) in scores {
            match score {
                Ok(value) => {
                    let views = self.rows.entry(row.to_owned()).or_default();
                    let scores = views.entry(view.to_owned()).or_default();
                    scores.insert(metric.to_owned(), value);
                }
                Err(why) => {
                    let of_row = self.missing.entry(row.to_owned()).or_default();
                    let missing = of_row.entry(metric.to_owned());
                    // The first reason stands for all views, which lack a metric for the same one
                    // as a rule.
                    missing.or_insert(Missing { views: 0, why }).views += 1;
                }
            }
        }
    }

    /// What an image scores against the truth, and against the low-resolution photo of the same
    /// view.
    pub fn measure(&mut self, image: Image, truth: Image, low: Image) -> Vec<Scored> {
        let width = image.width();
        let height = image.height();
        let too_small = |least: usize| format!("{width}x{height} pixels; a side needs {least}");
        let niqe = metrics::niqe(image);
        if let Some(niqe) = niqe.filter(|niqe| niqe.rank_deficient()) {
            // The least of all pictures: the warning is for the worst of them.
            self.blocks = Some(self.blocks.unwrap_or(BLOCKS).min(niqe.blocks));
        }
        let no_blocks = || "fewer than two blocks of 96x96 pixels with texture".to_owned();
        vec![
            ("psnr_hr", Ok(metrics::psnr(truth, image))),
            (
                "ssim_hr",
                metrics::ssim(truth, image).ok_or_else(|| too_small(11)),
            ),
            ("flip_hr", Ok(metrics::flip(truth, image).mean)),
            (
                "ssimulacra2_hr",
                metrics::ssimulacra2(truth, image).ok_or_else(|| too_small(113)),
            ),
            ("niqe_y", niqe.map(|niqe| niqe.value).ok_or_else(no_blocks)),
            (
                "psnr_lr_consistency",
                Ok(metrics::psnr_lr_consistency(image, low)),
            ),
        ]
    }

    /// What to say of NIQE, if it had few blocks.
    pub fn warning(&self) -> Option<String> {
        let blocks = self.blocks?;
        Some(format!(
            "niqe_y scatters here: it has statistics of {blocks} blocks of 96x96 pixels, and {BLOCKS} give them full rank"
        ))
    }

    /// The scores with their means and definitions.
    pub fn finish(self, own: &[(&str, &str)]) -> Metrics {
        let warning = self.warning();
        let views_of = |row: &str| self.rows.get(row).map_or(0, BTreeMap::len);
        let told = |row: &String, missing: &Missing| match views_of(row) {
            // Missing in every view needs no count.
            views if views > missing.views => {
                format!("{} of {views} views: {}", missing.views, missing.why)
            }
            _ => missing.why.clone(),
        };
        let absent = self.missing.iter().map(|(row, missing)| {
            let reasons = missing
                .iter()
                .map(|(metric, why)| (metric.clone(), told(row, why)));
            (row.clone(), reasons.collect())
        });
        let absent = absent.collect();
        let rows: BTreeMap<String, Row> = self
            .rows
            .into_iter()
            .map(|(name, views)| (name, with_means(views)))
            .collect();
        let mut definitions = definitions(&rows, own);
        if let (Some(niqe), Some(warning)) = (definitions.get_mut("niqe_y"), warning) {
            niqe.push_str(&format!(" ({warning})"));
        }
        Metrics {
            rows,
            definitions,
            absent,
        }
    }
}

/// What the columns that occur mean.
fn definitions(rows: &BTreeMap<String, Row>, own: &[(&str, &str)]) -> BTreeMap<String, String> {
    let occurs = |name: &str| rows.values().any(|row| row.mean.contains_key(name));
    let known = metrics::DEFINITIONS.iter().chain(own);
    known
        // A table does not explain columns that it lacks.
        .filter(|(name, _)| occurs(name))
        .map(|(name, text)| ((*name).to_owned(), (*text).to_owned()))
        .collect()
}

/// Adds the means over views to a row.
fn with_means(views: BTreeMap<String, BTreeMap<String, f64>>) -> Row {
    let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for (name, value) in views.values().flatten() {
        // Each metric has a count of its own, since a view may lack some.
        let (sum, count) = sums.entry(name.clone()).or_default();
        *sum += value;
        *count += 1.0;
    }
    Row {
        mean: sums
            .into_iter()
            .map(|(name, (sum, count))| (name, sum / count))
            .collect(),
        views,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_has_its_reason_and_how_many_views_lack_it() {
        let mut scores = Scores::default();
        for (view, score) in [
            ("a", Ok(2.0)),
            ("b", Err("hidden".to_owned())),
            ("c", Ok(4.0)),
        ] {
            scores.add("row", view, [("psnr_warped", score), ("psnr_hr", Ok(1.0))]);
        }
        scores.add("other", "a", [("psnr_warped", Err("no depth".to_owned()))]);
        let metrics = scores.finish(&[]);
        assert_eq!(metrics.rows["row"].mean["psnr_warped"], 3.0);
        assert_eq!(metrics.absent["row"]["psnr_warped"], "1 of 3 views: hidden");
        assert_eq!(metrics.absent["other"]["psnr_warped"], "no depth");
        assert!(metrics.definitions.contains_key("psnr_hr"));
    }

    #[test]
    fn few_blocks_are_told_where_the_metric_is_defined() {
        let rgb: Vec<f32> = (0..192 * 192 * 3)
            .map(|i| (i / 3 * 7919 % 251) as f32 / 251.0)
            .collect();
        let image = Image::new(192, 192, &rgb);
        let mut scores = Scores::default();
        let low = Image::new(48, 48, &rgb[..48 * 48 * 3]);
        let measured = scores.measure(image, image, low);
        scores.add("row", "a", measured);
        assert!(scores.warning().unwrap().contains("statistics of 4 blocks"));
        let definitions = scores.finish(&[]).definitions;
        assert!(
            definitions["niqe_y"].contains("4 blocks"),
            "{definitions:?}"
        );
    }
}
