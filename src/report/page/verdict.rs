//! What a comparison comes to, in a few sentences. Says only what the numbers say, and calls arms level
//! where the interval of their difference holds 0.

use crate::report::comparison::{Comparison, Metric, Scored, percent};
use crate::terminal::progress::figure;

/// So many arms that are level with the best are named.
const NAMED: usize = 4;

/// What won, by how much, how far it is from the bound, and where it does not win; a sentence or two each.
pub fn verdict(comparison: &Comparison) -> Vec<String> {
    // In order of how much they tell, so the first that has a direction decides who won.
    let mut metrics = comparison
        .metrics
        .iter()
        .filter(|metric| metric.better.is_some());
    let found = metrics
        .next()
        .and_then(|first| Some((first, comparison.best(first)?)));
    let Some((first, (best, second))) = found else {
        return vec!["No arm has scores yet.".into()];
    };
    let mut sentences = vec![format!(
        "{} is the best by {}: {}. {}",
        best.name,
        first.name,
        mean(best, first),
        next(comparison, best, second, first)
    )];
    sentences.extend(gap(comparison, best, first));
    // Against the photos: by what needs none, as consistency between views, a blurred field wins.
    let others = metrics.filter(|metric| metric.name.ends_with("_hr"));
    let others: Vec<String> = others
        .filter_map(|metric| by_another(comparison, best, metric))
        .collect();
    if !others.is_empty() {
        sentences.push(others.join(" "));
    }
    sentences.extend(worst(best, first));
    let all = comparison.arms.len();
    let silent = comparison.arms.iter().filter(|arm| arm.scores.is_empty());
    match silent.count() {
        0 => {}
        silent => sentences.push(format!("{silent} of {all} arms have no scores.")),
    }
    sentences
}

fn mean(arm: &Scored, metric: &Metric) -> String {
    let score = arm.scores.get(&metric.name);
    score.map_or("nothing".into(), |score| figure(score.mean))
}

/// Whether the 95 % interval of the difference of two arms holds 0.
fn level(best: &Scored, other: &Scored, metric: &Metric) -> bool {
    let interval = best
        .ahead_of(other, metric)
        .and_then(|ahead| ahead.interval);
    // Both ends on one side of 0 have a positive product.
    interval.is_some_and(|[low, high]| low * high <= 0.0)
}

/// Who is level with the best, or else how far behind the next is.
fn next(
    comparison: &Comparison,
    best: &Scored,
    second: Option<&Scored>,
    metric: &Metric,
) -> String {
    let level: Vec<String> = comparison
        .arms
        .iter()
        .filter(|arm| arm.name != best.name && Some(&arm.name) != comparison.bound.as_ref())
        .filter(|arm| level(best, arm, metric))
        .map(|arm| format!("{} ({})", arm.name, mean(arm, metric)))
        .collect();
    if !level.is_empty() {
        let more = match level.len().saturating_sub(NAMED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let are = if level.len() == 1 { "is" } else { "are" };
        return format!(
            "Level with it {are} {}{more}: the 95 % interval of the difference by view holds 0.",
            level[..level.len().min(NAMED)].join(", ")
        );
    }
    let ahead = second.and_then(|second| Some((second, best.ahead_of(second, metric)?)));
    ahead.map_or(String::new(), |(second, ahead)| {
        format!(
            "The next is {} with {}; the difference by view is {}, and {} is better in {} of {}.",
            second.name,
            mean(second, metric),
            ahead.range(),
            best.name,
            ahead.better,
            ahead.pairs
        )
    })
}

fn gap(comparison: &Comparison, best: &Scored, metric: &Metric) -> Option<String> {
    let gap = best.scores.get(&metric.name)?.gap_closed?;
    let bound = comparison.bound.as_ref()?;
    Some(format!(
        "That is {} of the way from the low-resolution field to {bound}.",
        percent(gap)
    ))
}

/// Whether the best arm is the best by another metric, too.
fn by_another(comparison: &Comparison, best: &Scored, metric: &Metric) -> Option<String> {
    let name = &metric.name;
    let (other, _) = comparison.best(metric)?;
    let own = mean(best, metric);
    Some(if other.name == best.name {
        format!("By {name} it is the best, too.")
    } else if level(best, other, metric) {
        format!("By {name} it is level with {}, the best.", other.name)
    } else {
        let theirs = mean(other, metric);
        format!(
            "By {name} {} is better: {theirs} against {own}.",
            other.name
        )
    })
}

/// The view in which the best arm is worst.
fn worst(best: &Scored, metric: &Metric) -> Option<String> {
    let better = metric.better?;
    let views = best.by_view(&metric.name);
    let (view, value) = views
        .iter()
        .reduce(|a, b| if better.beats(*a.1, *b.1) { b } else { a })?;
    Some(format!(
        "It is furthest from the photo in {view} ({}).",
        figure(*value)
    ))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::report::comparison::statistics::Better;
    use crate::report::comparison::{Cost, Score};

    /// An arm with a PSNR and an SSIM for each of its views.
    fn arm(name: &str, views: [[f64; 2]; 3], gap_closed: f64) -> Scored {
        let of = |[psnr, ssim]: [f64; 2]| {
            BTreeMap::from([("psnr_hr".into(), psnr), ("ssim_hr".into(), ssim)])
        };
        let score = |at: usize| Score {
            mean: views.iter().map(|view| view[at]).sum::<f64>() / 3.0,
            spread: None,
            difference: None,
            gap_closed: Some(gap_closed),
        };
        let named = |at: usize| (format!("view_{at}"), of(views[at]));
        Scored {
            name: name.into(),
            differences: BTreeMap::new(),
            scores: BTreeMap::from([("psnr_hr".into(), score(0)), ("ssim_hr".into(), score(1))]),
            absent: None,
            cost: Cost::default(),
            runs: vec![(0..3).map(named).collect()],
            source: None,
        }
    }

    fn said(arms: Vec<Scored>) -> Vec<String> {
        let metric = |name: &str| Metric {
            name: name.into(),
            definition: String::new(),
            better: Some(Better::Higher),
        };
        verdict(&Comparison {
            pipeline: "p".into(),
            run: String::new(),
            baseline: "low".into(),
            bound: Some("bound".into()),
            seeds: vec![0],
            metrics: vec![metric("psnr_hr"), metric("ssim_hr"), metric("psnr_warped")],
            arms,
            notes: Vec::new(),
        })
    }

    #[test]
    fn the_best_is_named_with_what_it_is_ahead_by() {
        let low = arm("low", [[20.0, 0.6], [21.0, 0.7], [22.0, 0.7]], 0.0);
        let ours = arm("ours", [[21.0, 0.7], [22.1, 0.8], [23.2, 0.8]], 0.25);
        let bound = arm("bound", [[25.0, 0.9], [25.0, 0.9], [26.0, 0.9]], 1.0);
        assert_eq!(
            said(vec![low, ours, bound]),
            [
                "ours is the best by psnr_hr: 22.10. The next is low with 21.00; the difference by view is \
                 +1.10 [+0.85, +1.35], and ours is better in 3 of 3.",
                "That is 25 % of the way from the low-resolution field to bound.",
                "By ssim_hr it is the best, too.",
                "It is furthest from the photo in view_0 (21.00).",
            ]
        );
    }

    #[test]
    fn arms_that_no_view_tells_apart_are_called_level() {
        let one = arm("one", [[21.0, 0.60], [22.0, 0.61], [23.0, 0.62]], 0.2);
        let other = arm("other", [[21.3, 0.70], [21.8, 0.72], [23.2, 0.71]], 0.2);
        let said = said(vec![one, other]);
        assert_eq!(
            said[0],
            "other is the best by psnr_hr: 22.10. Level with it is one (22.00): the 95 % interval of the \
             difference by view holds 0."
        );
        assert_eq!(said[2], "By ssim_hr it is the best, too.");
    }
}
