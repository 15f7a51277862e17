//! A comparison as tables: which cells they have. How cells are written down is the business of `rows`;
//! JSON is the comparison itself.

use clap::ValueEnum;

use super::rows::{Rows, csv, latex, markdown};
use super::statistics::{Better, Paired};
use super::{Comparison, Metric, Scored};
use crate::terminal::output::{size, table};
use crate::terminal::progress::{duration, figure};

/// How to write tables down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TableFormat {
    /// Aligned columns.
    Text,
    /// Markdown.
    Md,
    /// Comma-separated values, one line for each arm and metric.
    Csv,
    /// JSON, with the scores of each view.
    Json,
    /// LaTeX, for the package booktabs.
    Latex,
}

impl Comparison {
    /// All tables in a format.
    pub fn tables(&self, format: TableFormat) -> Vec<String> {
        let tables = [self.scores(), self.differences(), self.costs()];
        let mut texts: Vec<String> = match format {
            TableFormat::Text => tables.iter().map(|rows| table(rows, true)).collect(),
            TableFormat::Md => tables.iter().map(markdown).collect(),
            TableFormat::Latex => tables.iter().map(latex).collect(),
            TableFormat::Csv => return vec![self.csv()],
            TableFormat::Json => {
                let json = serde_json::to_value(self).unwrap_or_default();
                return vec![format!("{json:#}")];
            }
        };
        let notes = self.all_notes();
        if !notes.is_empty() {
            // As comments, so that the tables can be included in a document as they are.
            let comment = if format == TableFormat::Latex {
                "% "
            } else {
                ""
            };
            let lines: Vec<String> = notes
                .iter()
                .map(|note| format!("{comment}{note}"))
                .collect();
            // Two blanks at the end of a line of Markdown break it. Without them notes run
            // together.
            let between = if format == TableFormat::Md {
                "  \n"
            } else {
                "\n"
            };
            texts.push(lines.join(between));
        }
        texts
    }

    /// The parameters in which arms differ, an arm in each column.
    pub fn parameters(&self, format: TableFormat) -> String {
        let paths: std::collections::BTreeSet<&String> = self
            .arms
            .iter()
            .flat_map(|arm| arm.differences.keys())
            .collect();
        let head =
            std::iter::once("parameter".to_owned()).chain(self.arms.iter().map(|a| a.name.clone()));
        let row = |path: &String| {
            let cell = |arm: &Scored| arm.differences.get(path).cloned().unwrap_or_default();
            std::iter::once(path.clone())
                .chain(self.arms.iter().map(cell))
                .collect()
        };
        let rows: Rows = std::iter::once(head.collect())
            .chain(paths.into_iter().map(row))
            .collect();
        match format {
            TableFormat::Text => table(&rows, false),
            TableFormat::Md => markdown(&rows),
            TableFormat::Latex => latex(&rows),
            TableFormat::Csv => csv(&rows),
            TableFormat::Json => {
                let arms = self
                    .arms
                    .iter()
                    .map(|arm| (arm.name.clone(), arm.differences.clone()));
                let all: serde_json::Map<String, serde_json::Value> = arms
                    .map(|(name, differences)| (name, serde_json::json!(differences)))
                    .collect();
                format!("{:#}", serde_json::Value::Object(all))
            }
        }
    }

    /// Why arms or metrics are missing.
    fn all_notes(&self) -> Vec<String> {
        let of_arms = self.arms.iter().filter_map(|arm| arm.absent.clone());
        of_arms.chain(self.notes.iter().cloned()).collect()
    }

    fn rows(
        &self,
        corner: String,
        metrics: &[&Metric],
        cell: impl Fn(&Scored, &Metric) -> String,
    ) -> Rows {
        let head = metrics.iter().map(|metric| metric.title());
        let row = |arm: &Scored| {
            let cells = metrics.iter().map(|metric| cell(arm, metric));
            std::iter::once(arm.name.clone()).chain(cells).collect()
        };
        std::iter::once(std::iter::once(corner).chain(head).collect())
            .chain(self.arms.iter().map(row))
            .collect()
    }

    /// The mean of each metric, with its spread over seeds.
    pub fn scores(&self) -> Rows {
        let metrics: Vec<&Metric> = self.metrics.iter().collect();
        let cell = |arm: &Scored, metric: &Metric| match arm.scores.get(&metric.name) {
            Some(score) => match score.spread {
                Some(spread) => format!("{} ± {}", figure(score.mean), figure(spread)),
                None => figure(score.mean),
            },
            None => "-".into(),
        };
        self.rows(self.pipeline.clone(), &metrics, cell)
    }

    /// What each arm has ahead of the baseline.
    pub fn differences(&self) -> Rows {
        let metrics: Vec<&Metric> = self
            .metrics
            .iter()
            .filter(|metric| metric.better.is_some())
            .collect();
        let cell = |arm: &Scored, metric: &Metric| {
            let score = arm.scores.get(&metric.name);
            let difference = score.and_then(|score| score.difference.as_ref());
            difference.map_or("-".into(), Paired::text)
        };
        let mut rows = self.rows(format!("minus {}", self.baseline), &metrics, cell);
        // The baseline has nothing ahead of itself.
        rows.retain(|row| row[0] != self.baseline);
        rows
    }

    /// What each arm took, and how much of the way to the bound it has come.
    pub fn costs(&self) -> Rows {
        let gaps: Vec<&Metric> = self
            .metrics
            .iter()
            .filter(|metric| self.arms.iter().any(|arm| arm.gap(metric).is_some()))
            .collect();
        let head = [
            "cost".to_owned(),
            "time".to_owned(),
            "peak memory".to_owned(),
        ];
        let head = head.into_iter().chain(
            gaps.iter()
                .map(|metric| format!("gap closed, {}", metric.name)),
        );
        let row = |arm: &Scored| {
            let memory = arm.cost.peak_memory.map_or("-".into(), size);
            let closed = gaps.iter().map(|metric| {
                let gap = arm.gap(metric);
                gap.map_or("-".into(), percent)
            });
            [arm.name.clone(), duration(arm.cost.seconds), memory]
                .into_iter()
                .chain(closed)
                .collect()
        };
        std::iter::once(head.collect())
            .chain(self.arms.iter().map(row))
            .collect()
    }

    /// One line for each arm and metric, all numbers in full.
    fn csv(&self) -> String {
        let mut rows: Rows = vec![
            [
                "arm",
                "metric",
                "mean",
                "spread",
                "difference",
                "low",
                "high",
                "better_in",
                "views",
                "gap_closed",
            ]
            .map(str::to_owned)
            .into(),
        ];
        let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        for arm in &self.arms {
            for metric in &self.metrics {
                let Some(score) = arm.scores.get(&metric.name) else {
                    continue;
                };
                let paired = score.difference;
                let bound = |at: usize| paired.and_then(|paired| Some(paired.interval?[at]));
                let count = |of: fn(&Paired) -> usize| {
                    paired.map_or(String::new(), |paired| of(&paired).to_string())
                };
                rows.push(vec![
                    arm.name.clone(),
                    metric.name.clone(),
                    score.mean.to_string(),
                    number(score.spread),
                    number(paired.map(|paired| paired.mean)),
                    number(bound(0)),
                    number(bound(1)),
                    count(|paired| paired.better),
                    count(|paired| paired.pairs),
                    number(score.gap_closed),
                ]);
            }
            for (name, value) in [
                ("seconds", Some(arm.cost.seconds)),
                (
                    "peak_memory",
                    arm.cost.peak_memory.map(|bytes| bytes as f64),
                ),
            ] {
                let Some(value) = value else { continue };
                let mut row = vec![arm.name.clone(), name.to_owned(), value.to_string()];
                // Readers of CSV want as many cells in each line as in the first.
                row.resize(rows[0].len(), String::new());
                rows.push(row);
            }
        }
        csv(&rows)
    }
}

impl Metric {
    /// Its name, with an arrow towards what is better.
    pub fn title(&self) -> String {
        match self.better {
            Some(Better::Higher) => format!("{} ↑", self.name),
            Some(Better::Lower) => format!("{} ↓", self.name),
            None => self.name.clone(),
        }
    }
}

impl Scored {
    fn gap(&self, metric: &Metric) -> Option<f64> {
        self.scores.get(&metric.name)?.gap_closed
    }
}

/// A share in whole percent, without a sign before 0.
pub fn percent(share: f64) -> String {
    format!("{} %", (100.0 * share).round() as i64)
}
