//! What a comparison comes to, in a few sentences. Says only what the numbers say.

use crate::report::comparison::{Comparison, Metric, Scored, percent};
use crate::terminal::progress::figure;

/// What won, by how much, how far it is from the bound, and where it does not win.
pub fn verdict(comparison: &Comparison) -> String {
    // In order of how much they tell, so the first that has a direction decides who won.
    let mut metrics = comparison
        .metrics
        .iter()
        .filter(|metric| metric.better.is_some());
    let Some(first) = metrics.next() else {
        return "No arm has scores yet.".into();
    };
    let Some((best, second)) = comparison.best(first) else {
        return "No arm has scores yet.".into();
    };
    let mut sentences = vec![won(best, second, first)];
    if let Some((bound, gap)) = comparison.bound.as_ref().zip(gap(best, first)) {
        sentences.push(format!(
            "That is {} of the way from the low-resolution field to {bound}.",
            percent(gap)
        ));
    }
    let lost: Vec<String> = metrics
        .filter_map(|metric| {
            let (other, _) = comparison.best(metric)?;
            (other.name != best.name)
                .then(|| lost(best, other, metric))
                .flatten()
        })
        .collect();
    sentences.push(match lost.is_empty() {
        true => format!("{} is also the best by every other metric.", best.name),
        false => format!("It is not the best by {}.", lost.join(", ")),
    });
    sentences.extend(worst(best, first));
    let all = comparison.arms.len();
    let silent = comparison.arms.iter().filter(|arm| arm.scores.is_empty());
    match silent.count() {
        0 => {}
        silent => sentences.push(format!("{silent} of {all} arms have no scores.")),
    }
    sentences.join(" ")
}

fn won(best: &Scored, second: Option<&Scored>, metric: &Metric) -> String {
    let mean = |arm: &Scored| arm.scores.get(&metric.name).map_or(0.0, |score| score.mean);
    let name = &metric.name;
    let value = figure(mean(best));
    let ahead = second.and_then(|second| Some((second, best.ahead_of(second, metric)?)));
    let Some((second, ahead)) = ahead else {
        return format!("{} has the best {name}: {value}.", best.name);
    };
    let certain = match ahead.interval {
        // Both ends on one side of 0 have a positive product.
        Some([low, high]) if low * high > 0.0 => ", and the 95 % interval is clear of 0",
        Some(_) => ", but the 95 % interval holds 0: the two may be equal",
        None => "",
    };
    format!(
        "{} has the best {name}: {value} against {} of {}, the next best. It is better in {} of {} views by {} on average{certain}.",
        best.name,
        figure(mean(second)),
        second.name,
        ahead.better,
        ahead.pairs,
        figure(ahead.mean.abs()),
    )
}

fn gap(best: &Scored, metric: &Metric) -> Option<f64> {
    best.scores.get(&metric.name)?.gap_closed
}

fn lost(best: &Scored, other: &Scored, metric: &Metric) -> Option<String> {
    let mean = |arm: &Scored| Some(figure(arm.scores.get(&metric.name)?.mean));
    let own = mean(best).unwrap_or("nothing".into());
    Some(format!(
        "{} ({} has {}, it has {own})",
        metric.name,
        other.name,
        mean(other)?
    ))
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
