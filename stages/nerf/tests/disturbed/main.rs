//! What disturbs photos, and what is learnt to undo it: held-out views of a drawn scene whose truth
//! is known.

#![allow(clippy::unwrap_used)]

mod photos;

use metrics::Image;
use nerf::{
    ExposureOptions, Field, FieldConfig, Mask, PoseOptions, RenderOptions, Space, SpaceKind,
    TrainOptions, TrainView, Trainer, localize, render,
};
use photos::{Scene, with_exposures, with_poses_off, with_something_that_moves};
use scene::Photo;

/// Which of the disturbances, or which of the remedies.
#[derive(Clone, Copy, Default)]
struct Of {
    moves: bool,
    exposures: bool,
    poses: bool,
}

const NONE: Of = Of {
    moves: false,
    exposures: false,
    poses: false,
};

const ALL: Of = Of {
    moves: true,
    exposures: true,
    poses: true,
};

/// How large a check is.
struct Size {
    views: u32,
    pixels: (u32, u32),
    steps: u32,
    samples: u32,
    config: FieldConfig,
    poses: PoseOptions,
}

/// Of the held-out views, PSNR in dB, and PSNR at each view's own exposure.
#[derive(Clone, Copy, Debug)]
struct Quality {
    plain: f64,
    exposed: f64,
    /// At its own exposure, from where the field shows each photo best.
    posed: f64,
}

impl Size {
    fn fit(&self, disturbed: Of, remedies: Of) -> Quality {
        let mut scene = Scene::draw(self.views, self.pixels);
        if disturbed.moves {
            with_something_that_moves(&mut scene.train);
        }
        if disturbed.exposures {
            with_exposures(&mut scene.train);
        }
        if disturbed.poses {
            with_poses_off(&mut scene.train);
        }
        let views = self.views(&scene.train, remedies);
        let options = self.options(remedies);
        let mut trainer = Trainer::new(self.field(&scene, &views), views, &options, 1);
        (0..self.steps).for_each(|_| {
            trainer.step();
        });
        let field = trainer.into_field();
        let [plain, exposed] = quality(&field, &scene.held_out);
        let views = self.views(&scene.held_out, NONE);
        for (photo, view) in scene.held_out.iter_mut().zip(views) {
            photo.camera = localize(&field, view, 1);
        }
        let [_, posed] = quality(&field, &scene.held_out);
        Quality {
            plain,
            exposed,
            posed,
        }
    }

    fn views(&self, photos: &[Photo], remedies: Of) -> Vec<TrainView> {
        let view = |photo: &Photo| TrainView {
            camera: photo.camera,
            pixels: photo.pixels.clone().into(),
            mask: photo
                .mask
                .as_deref()
                .filter(|_| remedies.moves)
                .map(Mask::new),
            weight: 1.0,
            supersample: 2,
        };
        photos.iter().map(view).collect()
    }

    fn options(&self, remedies: Of) -> TrainOptions {
        TrainOptions {
            steps: self.steps,
            samples: self.samples,
            exposure: remedies.exposures.then(ExposureOptions::default),
            poses: remedies.poses.then(|| self.poses.clone()),
            ..TrainOptions::default()
        }
    }

    fn field(&self, scene: &Scene, views: &[TrainView]) -> Field {
        let bounds = scene.bounds.map(|corner| corner.map(|x| x as f32));
        let cameras: Vec<_> = views.iter().map(|view| &view.camera).collect();
        let space = Space::of(SpaceKind::Auto, bounds, &cameras).unwrap();
        Field::in_space(&self.config, space, 1)
    }
}

/// PSNR as it is and at each photo's exposure.
fn quality(field: &Field, held_out: &[Photo]) -> [f64; 2] {
    let options = RenderOptions {
        supersample: 2,
        ..RenderOptions::default()
    };
    let count = held_out.len() as f64;
    let mut sum = [0.0; 2];
    for photo in held_out {
        let [width, height] = [photo.camera.width, photo.camera.height].map(|side| side as usize);
        let rendered = render(field, &photo.camera, &options).rgb;
        let image = |rgb| Image::new(width, height, rgb);
        let truth = image(&photo.pixels.rgb);
        let exposed = metrics::exposed(image(&rendered), truth, None);
        sum[0] += metrics::psnr(truth, image(&rendered)) / count;
        sum[1] += metrics::psnr(truth, image(&exposed)) / count;
    }
    sum
}

/// The numbers of `docs/inputs.md`: some minutes.
#[test]
#[ignore = "takes minutes"]
fn every_disturbance_costs_at_most_half_a_db_once_it_is_learnt() {
    let size = Size {
        views: 24,
        pixels: (128, 96),
        steps: 3000,
        samples: 1 << 13,
        config: FieldConfig {
            levels: 12,
            log2_table: 15,
            finest_resolution: 256,
            ..FieldConfig::default()
        },
        poses: PoseOptions::default(),
    };
    let still = size.fit(NONE, NONE);
    println!("undisturbed: {still:.2?}");
    let cases = [
        (
            "something that moves",
            Of {
                moves: true,
                ..NONE
            },
        ),
        (
            "exposures",
            Of {
                exposures: true,
                ..NONE
            },
        ),
        (
            "poses",
            Of {
                poses: true,
                ..NONE
            },
        ),
    ];
    for (name, disturbed) in cases {
        let without = size.fit(disturbed, NONE);
        let with = size.fit(disturbed, disturbed);
        println!("{name}: without {without:.2?}, with {with:.2?}");
        assert!(with.posed > still.posed - 0.5, "{name}");
    }
}

/// All corrections against all disturbances in seconds: a smaller scene and fewer steps.
#[test]
fn what_is_learnt_about_photos_wins_back_much_of_what_disturbs_them() {
    let size = small();
    let without = size.fit(ALL, NONE);
    let with = size.fit(ALL, ALL);
    assert!(with.plain > without.plain + 0.5, "{without:?} {with:?}");
    assert!(with.exposed > without.exposed + 0.5, "{without:?} {with:?}");
}

fn small() -> Size {
    Size {
        views: 12,
        pixels: (48, 36),
        steps: 500,
        samples: 1 << 13,
        config: FieldConfig {
            levels: 8,
            log2_table: 13,
            finest_resolution: 96,
            occupancy_resolution: 32,
            ..FieldConfig::default()
        },
        poses: PoseOptions {
            rate: 3e-4,
            start: 100,
        },
    }
}

#[test]
fn training_that_was_interrupted_ends_with_the_same_bits_on_any_number_of_threads() {
    let size = small();
    let mut scene = Scene::draw(size.views, size.pixels);
    with_exposures(&mut scene.train);
    let views = size.views(&scene.train, ALL);
    let options = TrainOptions {
        poses: Some(PoseOptions {
            rate: 1e-3,
            start: 3,
        }),
        ..size.options(ALL)
    };
    let begin = || Trainer::new(size.field(&scene, &views), views.clone(), &options, 1);
    let steps = |trainer: &mut Trainer, count| (0..count).for_each(|_| _ = trainer.step());
    let mut straight = begin();
    steps(&mut straight, 12);
    let mut resumed = begin();
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    one.install(|| steps(&mut resumed, 5));
    let bounds = resumed.field().bounds();
    let config = resumed.field().config();
    let state = resumed.state();
    let again = Trainer::from_state(config, bounds, views.clone(), &options, 1, &state);
    let mut resumed = again.unwrap();
    steps(&mut resumed, 7);
    assert_eq!(straight.state(), resumed.state());
    assert_eq!(straight.cameras(), resumed.cameras());
    assert!(straight.cameras()[0] != views[0].camera);
}

#[test]
fn a_camera_that_is_off_is_found_again_by_a_field_that_shows_its_photo() {
    let size = small();
    let mut scene = Scene::draw(size.views, size.pixels);
    let views = size.views(&scene.train, NONE);
    let field = size.field(&scene, &views);
    let mut trainer = Trainer::new(field, views, &size.options(NONE), 1);
    (0..size.steps).for_each(|_| _ = trainer.step());
    let field = trainer.into_field();
    let photo = scene.train[0].clone();
    with_poses_off(&mut scene.train);
    let view = size.views(&scene.train[..1], NONE).remove(0);
    // Where what is as far as the camera looks appears in the image, in pixels.
    let seen = |camera: &formats::Camera| {
        let ahead = (camera.near * camera.far).sqrt();
        let world = photo.camera.camera_to_world;
        let world = world.transform_point3(-ahead * glam::DVec3::Z);
        let [x, y, _] = camera.project(world.to_array()).unwrap();
        glam::DVec2::new(x, y)
    };
    let off = |camera: &formats::Camera| (seen(camera) - seen(&photo.camera)).length();
    let given = off(&view.camera);
    let found = off(&localize(&field, view, 1));
    assert!(given > 0.3, "{given}");
    assert!(found < 0.3 * given, "{given} {found}");
}

#[test]
fn a_photo_of_which_nothing_counts_says_nothing_of_its_camera() {
    let size = small();
    let scene = Scene::draw(size.views, size.pixels);
    let views = size.views(&scene.train, NONE);
    let field = size.field(&scene, &views);
    let mut view = views[0].clone();
    let pixels = view.camera.width * view.camera.height;
    view.mask = Some(Mask::new(&vec![false; pixels as usize]));
    assert_eq!(localize(&field, view, 1), views[0].camera);
}
