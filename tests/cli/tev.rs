//! Images pushed to tev as stages finish: to a listener that understands its packets, and to none.

use std::fs;
use std::io::Read;
use std::net::TcpListener;

use artifacts_schema::{Artifact, ImageSet};

use crate::space::Space;

/// A packet, taken apart from its front.
struct Packet(Vec<u8>);

impl Packet {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let rest = self.0.split_off(N);
        std::mem::replace(&mut self.0, rest).try_into().unwrap()
    }

    fn byte(&mut self) -> u8 {
        self.take::<1>()[0]
    }

    fn number(&mut self) -> i32 {
        i32::from_le_bytes(self.take())
    }

    fn long(&mut self) -> i64 {
        i64::from_le_bytes(self.take())
    }

    fn text(&mut self) -> String {
        let end = self.0.iter().position(|byte| *byte == 0).unwrap();
        let rest = self.0.split_off(end + 1);
        let mut text = std::mem::replace(&mut self.0, rest);
        text.pop();
        String::from_utf8(text).unwrap()
    }

    fn texts(&mut self) -> Vec<String> {
        (0..self.number()).map(|_| self.text()).collect()
    }
}

/// All packets that one connection brings.
fn packets(listener: TcpListener) -> Vec<Packet> {
    let (mut socket, _) = listener.accept().unwrap();
    let mut bytes = Vec::new();
    socket.read_to_end(&mut bytes).unwrap();
    let mut packets = Vec::new();
    while !bytes.is_empty() {
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        let rest = bytes.split_off(length);
        packets.push(Packet(bytes.split_off(4)));
        bytes = rest;
    }
    packets
}

#[test]
fn each_image_is_pushed_as_its_stage_finishes() {
    let space = Space::new();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let tev = format!("--tev={}", listener.local_addr().unwrap());
    let taken = std::thread::spawn(move || packets(listener));
    space.ok(&["run", "tiny.ron", "--target=up", &tev]);
    let mut names = Vec::new();
    let mut taken = taken.join().unwrap().into_iter();
    while let Some(mut create) = taken.next() {
        assert_eq!(
            (create.byte(), create.byte()),
            (4, 0),
            "a new image, in the background"
        );
        let name = create.text();
        let [width, height] = [create.number(), create.number()];
        assert_eq!(create.texts(), ["R", "G", "B"]);
        let mut update = taken.next().unwrap();
        assert_eq!((update.byte(), update.byte()), (6, 0), "its pixels");
        assert_eq!(update.text(), name);
        assert_eq!(update.texts(), ["R", "G", "B"]);
        let window: [i32; 4] = std::array::from_fn(|_| update.number());
        assert_eq!(window, [0, 0, width, height]);
        let pixels = i64::from(width * height);
        let offsets: [i64; 3] = std::array::from_fn(|_| update.long());
        let strides: [i64; 3] = std::array::from_fn(|_| update.long());
        assert_eq!((offsets, strides), ([0, pixels, 2 * pixels], [1; 3]));
        if name == "up/view_001" {
            let up = ImageSet::read(&space.path("out/tiny/up/images")).unwrap();
            let green = up.views[0].pixels.rgb.iter().skip(1).step_by(3);
            let sent = update.0[4 * pixels as usize..]
                .chunks(4)
                .take(pixels as usize);
            let sent = sent.map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()));
            assert!(green.copied().eq(sent), "the pixels of {name}");
        }
        names.push(name);
    }
    assert!(names.contains(&"up/view_001".to_owned()), "{names:?}");
    assert!(
        names.iter().any(|name| name.starts_with("scene/")),
        "{names:?}"
    );
}

#[test]
fn a_tev_that_is_not_there_is_told_once_and_changes_nothing() {
    let space = Space::new();
    // A port at which nobody listens any more.
    let address = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let said = space.ok(&["run", "tiny.ron", &format!("--tev={address}")]);
    assert_eq!(
        said.err.matches("is shown nothing more").count(),
        1,
        "{}",
        said.err
    );
    assert!(fs::exists(space.path("out/tiny/again/images")).unwrap());
    let said = space.ok(&["run", "tiny.ron", "--force=up", "--tev=nowhere:port"]);
    assert!(
        said.err
            .contains("tev at nowhere:port is shown nothing more"),
        "{}",
        said.err
    );
}
