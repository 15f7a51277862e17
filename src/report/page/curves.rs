//! How loss and PSNR went while stages trained, one drawing for each stage of an arm's name and
//! each quantity, a line for each arm that has a stage of its own there. Knows only the lines of
//! logs.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use artifacts_schema::Log;

use super::html::escaped;
use crate::pipeline::experiment::arm_of;
use crate::report::results;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::results::Lookup;
use crate::store::runs::RunRecord;
use crate::terminal::progress::figure;

/// The quantities that are drawn.
const QUANTITIES: [&str; 2] = ["loss", "psnr"];
/// Points of a line at most.
const POINTS: usize = 200;
/// Drawings at most, and lines in each: more say nothing.
const DRAWINGS: usize = 16;
const LINES: usize = 12;

/// One drawing.
pub struct Curve {
    title: String,
    /// By arm: steps and values.
    lines: Vec<(String, Vec<(f64, f64)>)>,
}

/// The drawings of a run.
pub fn of(run: &RunRecord, store: &Store) -> Result<Vec<Curve>, StoreError> {
    let mut curves: BTreeMap<(String, &str), Curve> = BTreeMap::new();
    let mut seen = BTreeSet::new();
    for (name, stage) in &run.stages {
        // A stage that arms share has one curve, under the first of its names.
        let Some(key) = stage.key.filter(|key| seen.insert(*key)) else {
            continue;
        };
        let arm = arm_of(name).unwrap_or_default();
        // Without arm and seed, so that the same stage of several arms is drawn together.
        let short = name.rsplit('/').next().unwrap_or(name);
        let Lookup::Sound(record) = store.results.lookup(&key)? else {
            continue;
        };
        let log = results::log(store, &record)?;
        for quantity in QUANTITIES {
            let points = points(&log, quantity);
            // A single point draws no line.
            if points.len() < 2 {
                continue;
            }
            let curve = curves.entry((short.to_owned(), quantity)).or_insert(Curve {
                title: format!("{short}: {quantity}"),
                lines: Vec::new(),
            });
            if curve.lines.len() < LINES {
                curve.lines.push((arm.to_owned(), points));
            }
        }
    }
    Ok(curves.into_values().take(DRAWINGS).collect())
}

fn points(log: &Log, quantity: &str) -> Vec<(f64, f64)> {
    let point = |line: &serde_json::Value| Some((line["step"].as_f64()?, line[quantity].as_f64()?));
    let all: Vec<(f64, f64)> = log.lines.iter().filter_map(point).collect();
    // A drawing is 320 units wide, and would show no more points than these.
    let stride = all.len().div_ceil(POINTS).max(1);
    all.into_iter().step_by(stride).collect()
}

impl Curve {
    /// It as an SVG with its legend.
    pub fn svg(&self) -> String {
        const WIDTH: f64 = 320.0;
        const HEIGHT: f64 = 140.0;
        let all = || self.lines.iter().flat_map(|(_, points)| points);
        let range = |of: fn(&(f64, f64)) -> f64| {
            let values = all().map(of);
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
                [low.min(value), high.max(value)]
            })
        };
        let [first, last] = range(|point| point.0);
        let [low, high] = range(|point| point.1);
        let place = |(x, y): &(f64, f64)| {
            // Where all values are one there is nothing to divide by.
            let across = (x - first) / (last - first).max(1e-12);
            let up = (y - low) / (high - low).max(1e-12);
            format!("{:.1},{:.1}", across * WIDTH, (1.0 - up) * HEIGHT)
        };
        let mut lines = String::new();
        let mut legend = String::new();
        for (number, (arm, points)) in self.lines.iter().enumerate() {
            let places: Vec<String> = points.iter().map(place).collect();
            let _ = write!(
                lines,
                "<polyline class=\"c{}\" points=\"{}\"/>",
                number % LINES,
                places.join(" ")
            );
            let _ = write!(
                legend,
                "<li class=\"c{}\">{}</li>",
                number % LINES,
                escaped(arm)
            );
        }
        let title = escaped(&self.title);
        format!(
            "<figure class=\"curve\"><figcaption>{title}</figcaption>\
             <svg viewBox=\"-2 -4 {} {}\" role=\"img\" aria-label=\"{title}\">{lines}</svg>\
             <p>{} to {} over {last} steps</p><ul class=\"legend\">{legend}</ul></figure>",
            WIDTH + 4.0,
            HEIGHT + 8.0,
            figure(low),
            figure(high),
        )
    }
}
