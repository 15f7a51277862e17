//! The report of a comparison: one HTML file with all its pictures, which works from disk and
//! without a network. Knows arms, scores and pictures; computes none of them.

mod crops;
mod curves;
mod gallery;
mod graph;
mod html;
mod verdict;

pub use gallery::Gallery;

use serde_json::json;

use crate::report::comparison::{Comparison, Scored, StageCost};
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::runs::RunRecord;
use crate::terminal::output::size;
use crate::terminal::progress::{duration, figure};
use graph::ProvenanceGraph;
use html::{Html, escaped};

/// How many crops are shown, and how many of the worst views.
const FEW: usize = 3;

/// Everything that a report tells.
pub struct Page<'a> {
    /// The arms side by side.
    pub comparison: &'a Comparison,
    /// Their pictures.
    pub gallery: &'a Gallery,
    /// The run that it is of.
    pub run: &'a RunRecord,
    /// Where results are.
    pub store: &'a Store,
}

impl Page<'_> {
    /// The whole file.
    pub fn html(&self) -> Result<String, StoreError> {
        let mut html = Html::default();
        html.put("<main>");
        html.tag("h1", &self.comparison.pipeline);
        html.put("<div class=\"verdict\">");
        for sentences in verdict::verdict(self.comparison) {
            html.tag("p", &sentences);
        }
        html.put("</div>");
        self.tables(&mut html);
        self.wall(&mut html);
        self.crops(&mut html);
        self.worst(&mut html);
        self.curves(&mut html)?;
        self.stages(&mut html)?;
        self.parameters(&mut html);
        self.provenance(&mut html);
        html.put("</main>");
        // A name with `</script>` in it would end the script. In JSON, `<\/` is the same text.
        let data = self.data().to_string().replace("</", "<\\/");
        // `data:,` as icon, or browsers would ask for `favicon.ico` beside a file on disk.
        Ok(format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <link rel=\"icon\" href=\"data:,\">\n<title>{} - comparison</title>\n<style>\n{}\n{}</style>\n</head>\n<body>\n{}\n\
             <script type=\"application/json\" id=\"data\">{data}</script>\n<script>\n{}</script>\n</body>\n</html>\n",
            escaped(&self.comparison.pipeline),
            include_str!("page/style.css"),
            self.gallery.styles(),
            html.text,
            include_str!("page/script.js"),
        ))
    }

    fn tables(&self, html: &mut Html) {
        html.section("scores", "Scores");
        let bound = self.comparison.bound.as_deref();
        let about = format!(
            "Means over {} held-out views. The best of each column is bold{}.",
            self.gallery.views.len(),
            bound.map_or(String::new(), |name| format!(
                "; {name}, the bound, is left out"
            )),
        );
        html.tag("p", &about);
        html.table(&self.comparison.scores(), |row, column| {
            self.is_best(row, column)
        });
        html.tag("h3", &format!("Difference to {}", self.comparison.baseline));
        html.tag(
            "p",
            "Paired by view: the mean difference, its 95 % interval over views, and in how many views the arm is better.",
        );
        html.table(&self.comparison.differences(), |_, _| false);
        html.tag("h3", "Cost");
        html.tag(
            "p",
            "Seconds when each stage was computed; a stage that arms share counts for each. Memory is the program's, while the stage ran.",
        );
        html.table(&self.comparison.costs(), |_, _| false);
        let notes = self.comparison.notes.iter().cloned();
        let absent = self
            .comparison
            .arms
            .iter()
            .filter_map(|arm| arm.absent.clone());
        html.list(absent.chain(notes));
        html.put("<details><summary>What the columns mean</summary><dl>");
        for metric in &self.comparison.metrics {
            html.tag("dt", &metric.name);
            html.tag("dd", &metric.definition);
        }
        html.put("</dl></details></section>");
    }

    fn is_best(&self, row: usize, column: usize) -> bool {
        // Column 0 has the names of arms, and wraps around to a metric that there is not.
        let best = self.comparison.metrics.get(column.wrapping_sub(1));
        let best = best.and_then(|metric| self.comparison.best(metric));
        let arm = self.comparison.arms.get(row);
        matches!((best, arm), (Some((best, _)), Some(arm)) if best.name == arm.name)
    }

    /// The image wall; what JavaScript does with it is in `script.js`.
    fn wall(&self, html: &mut Html) {
        html.section("wall", "Pictures");
        html.list(self.gallery.note.clone().into_iter());
        html.put(include_str!("page/viewer.html"));
        html.put("<div id=\"thumbs\">");
        for (at, view) in self.gallery.views.iter().enumerate() {
            html.tag("h3", view);
            html.put("<div class=\"row\">");
            if let Some(photo) = self.gallery.photo(at) {
                html.picture(photo, "photo", &format!("{view}, the photo"));
            }
            for (number, arm) in self.comparison.arms.iter().enumerate() {
                if let Some(picture) = self.gallery.render(number, at) {
                    let caption = self.caption(arm, view);
                    html.picture(picture, &caption, &format!("{view}, {caption}"));
                }
            }
            html.put("</div>");
        }
        html.put("</div></section>");
    }

    /// An arm's name with its first score in a view.
    fn caption(&self, arm: &Scored, view: &str) -> String {
        // Metrics come in order of how much they tell, so one suffices under a small picture.
        let metric = self.comparison.metrics.first();
        let value = metric.and_then(|metric| arm.by_view(&metric.name).get(view).copied());
        match value {
            Some(value) => format!("{} {}", arm.name, figure(value)),
            None => arm.name.clone(),
        }
    }

    fn crops(&self, html: &mut Html) {
        let crops = crops::telling(self.gallery, FEW);
        if crops.is_empty() {
            return;
        }
        html.section("crops", "Where arms differ most");
        for crop in &crops {
            let view = &self.gallery.views[crop.view];
            html.tag(
                "h3",
                &format!(
                    "{view}, {} pixels square at {}, {}",
                    crop.side, crop.left, crop.top
                ),
            );
            html.put("<div class=\"row\">");
            if let Some(photo) = self.gallery.photo(crop.view) {
                html.crop(
                    photo,
                    crop,
                    "photo",
                    &format!("{view}, a part of the photo"),
                );
            }
            for (number, arm) in self.comparison.arms.iter().enumerate() {
                if let Some(picture) = self.gallery.render(number, crop.view) {
                    html.crop(
                        picture,
                        crop,
                        &arm.name,
                        &format!("{view}, a part of {}", arm.name),
                    );
                }
            }
            html.put("</div>");
        }
        html.put("</section>");
    }

    /// The views in which the best arm is worst.
    fn worst(&self, html: &mut Html) {
        // Of a metric that is better neither way no view is the worst.
        let Some(metric) = self.comparison.metrics.iter().find(|m| m.better.is_some()) else {
            return;
        };
        let Some((best, _)) = self.comparison.best(metric) else {
            return;
        };
        let number = self
            .comparison
            .arms
            .iter()
            .position(|arm| arm.name == best.name);
        let mut views: Vec<(String, f64)> = best.by_view(&metric.name).into_iter().collect();
        let beats = |a: f64, b: f64| metric.better.is_some_and(|better| better.beats(a, b));
        // Worst first: who beats the other goes behind it.
        views.sort_by(|(_, a), (_, b)| beats(*a, *b).cmp(&beats(*b, *a)));
        html.section("worst", &format!("Where {} is worst", best.name));
        for (view, value) in views.iter().take(FEW) {
            let Some((at, number)) = self.gallery.place(view).zip(number) else {
                continue;
            };
            html.tag("h3", &format!("{view}: {} {}", metric.name, figure(*value)));
            html.put("<div class=\"row\">");
            let pictures = [
                (self.gallery.photo(at), "photo"),
                (self.gallery.render(number, at), best.name.as_str()),
                (self.gallery.error(number, at), "what FLIP sees"),
            ];
            for (picture, caption) in pictures {
                if let Some(picture) = picture {
                    html.picture(picture, caption, &format!("{view}, {caption}"));
                }
            }
            html.put("</div>");
        }
        html.put("</section>");
    }

    fn curves(&self, html: &mut Html) -> Result<(), StoreError> {
        let curves = curves::of(self.run, self.store)?;
        if !curves.is_empty() {
            html.section("curves", "Curves");
            for curve in &curves {
                html.put(&curve.svg());
            }
            html.put("</section>");
        }
        Ok(())
    }

    /// Every stage of the run with its end, its cost and its reason: drawn, and as a table.
    fn stages(&self, html: &mut Html) -> Result<(), StoreError> {
        html.section("stages", "Stages");
        if let Some(graph) = ProvenanceGraph::of(self.run, self.store)? {
            html.tag("p", "Each box is a result: its stage, its arm, and what it took when it was computed. Lines lead to what was made from it; those that others imply are left out.");
            html.put("<p class=\"states\"><span class=\"ran\">ran in this run</span><span class=\"cached\">cached</span><span class=\"failed\">failed</span><span class=\"stopped\">stopped</span></p>");
            html.put(&format!(
                "<div class=\"scroll graph\" tabindex=\"0\">{}</div>",
                graph.svg()
            ));
        }
        html.put("<details><summary>Each stage, what became of it in this run, and why</summary>");
        let head = ["arm", "stage", "state", "time", "peak memory", "why it ran"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        for arm in &self.comparison.arms {
            for (stage, cost) in &arm.cost.stages {
                rows.push(self.stage(&arm.name, stage, cost));
            }
        }
        html.table(&rows, |_, _| false);
        html.put("</details></section>");
        Ok(())
    }

    fn stage(&self, arm: &str, stage: &str, cost: &StageCost) -> Vec<String> {
        let experiment = self.run.experiment.iter();
        let mut folders = experiment.flat_map(|experiment| experiment.folders(arm));
        // Of several seeds, the first that is in the run stands for all.
        let run = folders.find_map(|folder| self.run.stages.get(&format!("{folder}/{stage}")));
        let state = run.map_or("-".into(), |run| format!("{:?}", run.end).to_lowercase());
        let memory = cost.peak_memory.map_or("-".into(), size);
        let why = run.and_then(|run| run.reason.clone()).unwrap_or_default();
        let time = duration(cost.seconds);
        vec![arm.to_owned(), stage.to_owned(), state, time, memory, why]
    }

    fn parameters(&self, html: &mut Html) {
        html.section("parameters", "Parameters that differ");
        let mut rows = vec![["arm", "parameter", "value"].map(str::to_owned).to_vec()];
        for arm in &self.comparison.arms {
            for (path, value) in &arm.differences {
                rows.push(vec![arm.name.clone(), path.clone(), value.clone()]);
            }
        }
        html.table(&rows, |_, _| false);
        html.put("</section>");
    }

    fn provenance(&self, html: &mut Html) {
        html.section("provenance", "How to get it again");
        let command = self.run.command.clone().unwrap_or_default();
        html.put(&format!("<pre><code>{}</code></pre>", escaped(&command)));
        let seeds = match &self.comparison.seeds[..] {
            [] => "the pipeline's own seed".to_owned(),
            seeds => format!("seeds {seeds:?}"),
        };
        let version = env!("CARGO_PKG_VERSION");
        html.tag(
            "p",
            &format!(
                "Run {}, {seeds}, srnerf-dag {version}.",
                self.comparison.run
            ),
        );
        html.put("<details><summary>Keys of the results that hold the scores</summary>");
        let mut rows = vec![["arm", "key"].map(str::to_owned).to_vec()];
        for arm in &self.comparison.arms {
            let key = arm.source.as_ref().map(|record| record.key.to_string());
            rows.push(vec![arm.name.clone(), key.unwrap_or_default()]);
        }
        html.table(&rows, |_, _| false);
        html.put("</details></section>");
    }

    /// What the viewer needs to know.
    fn data(&self) -> serde_json::Value {
        // Pictures by their classes alone: their bytes stand once in the file, in its styles.
        let views = self.gallery.views.iter().enumerate().map(|(at, view)| {
            json!({ "name": view, "photo": self.gallery.photo(at).map(|picture| picture.class()) })
        });
        let arms = self.comparison.arms.iter().enumerate().map(|(number, arm)| {
            let of_views = |picture: &dyn Fn(usize) -> Option<String>| -> Vec<Option<String>> {
                (0..self.gallery.views.len()).map(picture).collect()
            };
            json!({
                "name": arm.name,
                "captions": self.gallery.views.iter().map(|view| self.caption(arm, view)).collect::<Vec<_>>(),
                "renders": of_views(&|at| Some(self.gallery.render(number, at)?.class())),
                "errors": of_views(&|at| Some(self.gallery.error(number, at)?.class())),
            })
        });
        json!({
            "views": views.collect::<Vec<_>>(),
            "arms": arms.collect::<Vec<_>>(),
            "baseline": self.comparison.baseline,
        })
    }
}
