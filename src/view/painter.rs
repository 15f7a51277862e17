//! Renders for whoever asked last, coarse first. Knows fields and cameras, and nothing of HTTP.

use std::time::{Duration, Instant};

use compute::Device;
use formats::Camera;
use nerf::{RenderOptions, Rendered, Renderer};
use serde_json::json;
use tokio::sync::mpsc::Sender;

use super::look::Look;
use super::newest::Newest;
use super::picture::{self, ImageFormat};
use super::subject::Subject;

/// How fine pictures are, one after the other: the part of the full width, and rays per pixel and
/// axis.
const LEVELS: [Level; 5] = [
    Level::part(8),
    Level::part(4),
    Level::part(2),
    Level::part(1),
    Level { part: 1, rays: 2 },
];
/// The most frames of an order.
pub const MOST_FRAMES: usize = 2 * LEVELS.len();
/// The first pictures are as fine as they can be within this time.
const SOON: Duration = Duration::from_millis(120);
/// How many rays a second are expected before any was seen.
const FIRST_GUESS: f64 = 1e5;
/// How much a picture changes what is expected of the next.
const NEWS: f64 = 0.5;

/// A look, and whom to send what it sees.
pub struct Order {
    /// What is asked for.
    pub look: Look,
    /// Its camera, at full size.
    pub camera: Camera,
    /// Takes each frame as [`frame`] writes it, and holds [`MOST_FRAMES`].
    pub reply: Sender<Vec<u8>>,
}

/// How fine a picture is.
#[derive(Clone, Copy)]
struct Level {
    part: u32,
    rays: u32,
}

/// A newer order is there, or whoever gave this one has gone.
struct Overtaken;

impl Level {
    const fn part(part: u32) -> Self {
        Self { part, rays: 1 }
    }

    fn camera(self, camera: &Camera) -> Camera {
        // Rounded up, so that no picture has a side of 0.
        let side = |side: u32| side.div_ceil(self.part);
        camera.scaled(side(camera.width), side(camera.height))
    }

    /// How many rays all panes take.
    fn count(self, order: &Order) -> f64 {
        let pixels = f64::from(order.camera.width) * f64::from(order.camera.height);
        let rays = pixels * f64::from(self.rays).powi(2) / f64::from(self.part).powi(2);
        rays * order.look.panes.len() as f64
    }
}

/// Fields on a device, and how fast they were of late.
pub struct Painter<'s> {
    renderers: Vec<Renderer<'s>>,
    rays_per_second: f64,
}

impl<'s> Painter<'s> {
    /// For the fields of a subject.
    pub fn new(subject: &'s Subject, device: &Device) -> Self {
        let fields = subject.fields.iter();
        Self {
            renderers: fields
                .map(|(_, field)| Renderer::new(device, field))
                .collect(),
            rays_per_second: FIRST_GUESS,
        }
    }

    /// Goes on until the orders are closed.
    pub fn work(&mut self, orders: &Newest<Order>) {
        while let Some(order) = orders.take() {
            let stop = || match orders.has_news() || order.reply.is_closed() {
                true => Err(Overtaken),
                false => Ok(()),
            };
            // Whoever gave an order that was overtaken has given a newer one, or has gone.
            let _ = self.fulfil(&order, &stop);
        }
    }

    fn fulfil(
        &mut self,
        order: &Order,
        stop: &(impl Fn() -> Result<(), Overtaken> + Sync),
    ) -> Result<(), Overtaken> {
        let first = self.first_level(order);
        // A camera on its way will have moved on before a finer picture is done.
        let levels = if order.look.moving {
            &LEVELS[first..=first]
        } else {
            &LEVELS[first..]
        };
        for level in levels {
            self.paint(order, *level, stop)?;
        }
        Ok(())
    }

    /// The finest level that is there soon.
    fn first_level(&self, order: &Order) -> usize {
        let soon = |level: &Level| {
            // Several rays a pixel are never the first picture: what they add is seen only at rest.
            level.rays == 1 && level.count(order) <= SOON.as_secs_f64() * self.rays_per_second
        };
        // Something has to be shown, however slow the device is.
        LEVELS.iter().rposition(soon).unwrap_or(0)
    }

    fn paint(
        &mut self,
        order: &Order,
        level: Level,
        stop: &(impl Fn() -> Result<(), Overtaken> + Sync),
    ) -> Result<(), Overtaken> {
        let begun = Instant::now();
        let camera = level.camera(&order.camera);
        let options = RenderOptions {
            supersample: level.rays,
            ..RenderOptions::default()
        };
        for (number, pane) in order.look.panes.iter().enumerate() {
            let rendered = self.renderers[pane.field].try_render(&camera, &options, stop)?;
            let frame = frame(order, number, level, &rendered, &camera).ok_or(Overtaken)?;
            // The channel holds all frames of an order, so this fails only when nobody listens any
            // more.
            order.reply.try_send(frame).map_err(|_| Overtaken)?;
        }
        // A clock that is too coarse for a small picture must not give an infinite speed, which no
        // average would get rid of.
        let speed = level.count(order) / begun.elapsed().as_secs_f64().max(1e-6);
        // A moving average: how fast rays are depends on where the camera looks.
        self.rays_per_second += NEWS * (speed - self.rays_per_second);
        Ok(())
    }
}

/// A line of JSON that says what a picture is, and the bytes of its file.
fn frame(
    order: &Order,
    number: usize,
    level: Level,
    rendered: &Rendered,
    camera: &Camera,
) -> Option<Vec<u8>> {
    // What is soon replaced may lose a little, and comes sooner.
    let format = match order.look.moving || level.part > 1 {
        true => ImageFormat::Jpeg,
        false => ImageFormat::Png,
    };
    let colors = picture::colors(order.look.panes[number].show, rendered, camera);
    let file = picture::encode(&colors, [rendered.width, rendered.height], format).ok()?;
    let head = json!({
        "pane": number,
        "width": rendered.width,
        "height": rendered.height,
        "part": level.part,
        "rays": level.rays,
        "type": format.mime(),
        "bytes": file.len(),
    });
    let mut frame = format!("{head}\n").into_bytes();
    frame.extend(file);
    Some(frame)
}

#[cfg(test)]
mod tests {
    use super::super::look::{Pane, Show, Stand};
    use super::*;

    fn order(panes: usize) -> Order {
        let pane = Pane {
            field: 0,
            show: Show::Color,
        };
        let look = Look {
            stand: Stand::Photo(0),
            width: 640,
            panes: vec![pane; panes],
            moving: true,
        };
        Order {
            look,
            camera: Camera::centered((640, 480), 600.0, Default::default(), [1.0, 2.0]),
            reply: tokio::sync::mpsc::channel(MOST_FRAMES).0,
        }
    }

    #[test]
    fn the_first_picture_is_as_fine_as_speed_allows() {
        for (rays_per_second, panes, part) in [
            (1e9, 1, 1),
            (1e6, 1, 2),
            (1e6, 2, 4),
            (1e5, 1, 8),
            (1.0, 1, 8),
        ] {
            let painter = Painter {
                renderers: Vec::new(),
                rays_per_second,
            };
            let first = LEVELS[painter.first_level(&order(panes))];
            assert_eq!(
                (first.part, first.rays),
                (part, 1),
                "{rays_per_second} {panes}"
            );
        }
    }
}
