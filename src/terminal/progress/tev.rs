//! Images pushed to tev, the viewer, as stages finish, beside whatever else tells of the run. What
//! tev does not take is told once, and the run neither fails nor waits: pushing has a thread of its
//! own.

use std::net::{TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use artifacts_schema::{Artifact, ArtifactKind, ImageSet, View as Image};
use tev_client::{PacketCreateImage, PacketUpdateImage, TevClient};

use super::{Event, Progress};
use crate::store::view::View;

/// Where tev listens if it is not told otherwise.
pub const USUAL: &str = "127.0.0.1:14158";
const USUAL_PORT: u16 = 14158;

/// How long tev may take to answer, and to take a part of an image.
const PATIENCE: Duration = Duration::from_secs(2);

/// Images of a stage.
struct Push {
    /// What their names begin with: `i3ds.1.render`.
    stage: String,
    /// The image set.
    folder: PathBuf,
}

/// Another way of telling, and tev.
pub struct Tev {
    told: Box<dyn Progress>,
    view: View,
    pushes: Option<Sender<Push>>,
    /// What went wrong, if anything does.
    troubles: Receiver<String>,
    thread: Option<JoinHandle<()>>,
}

impl Tev {
    /// Tells `told` all, and shows tev, which listens there, the images that stages leave in `view`.
    pub fn beside(told: Box<dyn Progress>, address: &str, view: &View) -> Self {
        let address = match address.contains(':') {
            true => address.to_owned(),
            false => format!("{address}:{USUAL_PORT}"),
        };
        let (pushes, queue) = channel();
        let (complain, troubles) = channel();
        let push_all = move || {
            if let Err(error) = push_all(&address, &queue) {
                let _ = complain.send(format!("tev at {address} is shown nothing more: {error}"));
            }
        };
        Self {
            told,
            view: view.clone(),
            pushes: Some(pushes),
            troubles,
            thread: Some(std::thread::spawn(push_all)),
        }
    }

    fn push(&self, stage: &str, outputs: impl Iterator<Item = PathBuf>) {
        for folder in outputs {
            let stage = stage.to_owned();
            if let Some(pushes) = &self.pushes {
                // Nobody listens any more once something went wrong, which is told.
                let _ = pushes.send(Push { stage, folder });
            }
        }
    }

    fn tell_troubles(&mut self) {
        while let Ok(text) = self.troubles.try_recv() {
            self.told.event(&Event::Notice { text: &text });
        }
    }
}

impl Progress for Tev {
    fn event(&mut self, event: &Event) {
        self.told.event(event);
        if let Event::Finished { stage, record, .. } = event {
            let images = record.outputs.iter();
            let images = images.filter(|(_, output)| output.kind == ArtifactKind::Images);
            self.push(stage, images.map(|(name, _)| self.view.output(stage, name)));
        }
        self.tell_troubles();
    }
}

impl Drop for Tev {
    /// The last images are shown before the program ends.
    fn drop(&mut self) {
        // The thread ends when its queue does, so that closes first.
        self.pushes = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        self.tell_troubles();
    }
}

/// Connects with the first images, and shows all that come.
fn push_all(address: &str, queue: &Receiver<Push>) -> std::io::Result<()> {
    let mut tev = None;
    for Push { stage, folder } in queue {
        let tev = match &mut tev {
            Some(tev) => tev,
            // Not before there is something to show: a user may start tev while the first stages
            // run.
            None => tev.insert(connect(address)?),
        };
        show(tev, &stage, &folder)?;
    }
    Ok(())
}

fn connect(address: &str) -> std::io::Result<TevClient> {
    let nowhere = || std::io::Error::other("it is no address");
    // `connect_timeout` takes one address. `connect` by itself tries for minutes where nothing
    // answers.
    let address = address.to_socket_addrs()?.next().ok_or_else(nowhere)?;
    let socket = TcpStream::connect_timeout(&address, PATIENCE)?;
    // A tev that hangs must not keep the program from ending.
    socket.set_write_timeout(Some(PATIENCE))?;
    Ok(TevClient::wrap(socket))
}

fn show(tev: &mut TevClient, stage: &str, folder: &Path) -> std::io::Result<()> {
    let images = ImageSet::read(folder).map_err(std::io::Error::other)?;
    images.views.iter().try_for_each(|view| {
        let name = format!("{stage}/{}", view.name);
        show_view(tev, &name, view)
    })
}

/// Colours, coverage and depth as they are: scene-linear, premultiplied.
fn show_view(tev: &mut TevClient, name: &str, view: &Image) -> std::io::Result<()> {
    let size = [view.camera.width, view.camera.height];
    let plane = |at: usize| {
        view.pixels
            .rgb
            .iter()
            .skip(at)
            .step_by(3)
            .copied()
            .collect()
    };
    let mut channels: Vec<(&str, Vec<f32>)> =
        vec![("R", plane(0)), ("G", plane(1)), ("B", plane(2))];
    channels.extend(view.pixels.alpha.iter().map(|alpha| ("A", alpha.clone())));
    channels.extend(view.depth.iter().map(|depth| ("depth.Z", depth.clone())));
    let names: Vec<&str> = channels.iter().map(|(name, _)| *name).collect();
    let pixels = u64::from(size[0]) * u64::from(size[1]);
    let offsets: Vec<u64> = (0..names.len() as u64)
        .map(|channel| channel * pixels)
        .collect();
    let data: Vec<f32> = channels.into_iter().flat_map(|(_, plane)| plane).collect();
    tev.send(PacketCreateImage {
        image_name: name,
        grab_focus: false,
        width: size[0],
        height: size[1],
        channel_names: &names,
    })?;
    tev.send(PacketUpdateImage {
        image_name: name,
        grab_focus: false,
        channel_names: &names,
        channel_offsets: &offsets,
        // Planes lie one behind the other, not pixel by pixel.
        channel_strides: &vec![1; names.len()],
        x: 0,
        y: 0,
        width: size[0],
        height: size[1],
        data: &data,
    })
}
