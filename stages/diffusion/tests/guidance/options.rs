//! Options of a run: read as they are written, and refused by field.

use diffusion::guidance::{Guidance, InvalidOption, Rsd, Sds, Timesteps, Vsd};
use diffusion::optimize::{Optimization, Options};

use crate::run::{options, prior, views};

#[test]
fn options_that_make_no_sense_are_refused_by_field() {
    let vsd = Vsd::default();
    let refused = [
        Options {
            steps: 0,
            ..options()
        },
        Options {
            crop: 0,
            ..options()
        },
        Options {
            guidance_scale: f64::NAN,
            ..options()
        },
        Options {
            noise_level: 400,
            ..options()
        },
        Options {
            guidance: Guidance::Vsd(Vsd {
                lora_every: 0,
                ..vsd
            }),
            ..options()
        },
        Options {
            guidance: Guidance::Vsd(Vsd {
                camera_drop: 1.5,
                ..vsd
            }),
            ..options()
        },
        Options {
            guidance: Guidance::Sds(Sds {
                rate: -1.0,
                ..Sds::default()
            }),
            ..options()
        },
        Options {
            guidance: Guidance::Rsd(Rsd {
                timesteps: Timesteps::Uniform { min: 0.9, max: 0.1 },
                ..Rsd::default()
            }),
            ..options()
        },
    ]
    .map(|options| {
        Optimization::new(&prior(), &views(), &options, 1)
            .err()
            .unwrap()
            .to_string()
    });
    assert_eq!(
        refused,
        [
            "`steps` is 0; it must be at least 1",
            "`crop` is 0; it must be at least 1",
            "`guidance_scale` is NaN; it must be a number above 0",
            "`noise_level` is 400; it must be at most 350",
            "`guidance.lora_every` is 0; it must be at least 1",
            "`guidance.camera_drop` is 1.5; it must be from 0 to 1",
            "`guidance.rate` is -1; it must be a number above 0",
            "`guidance.timesteps` reaches from 0.9 to 0.1; its ends are the wrong way round",
        ]
    );
}

#[test]
fn options_read_as_they_are_written_and_refuse_what_they_do_not_know() {
    let text = serde_json::to_string(&Options::default()).unwrap();
    assert_eq!(
        serde_json::from_str::<Options>(&text).unwrap(),
        Options::default()
    );
    assert!(text.contains(r#""guidance":{"Vsd":{"rate":"#), "{text}");
    let one: Options = serde_json::from_str(r#"{"guidance": {"Vsd": {"lora_every": 3}}}"#).unwrap();
    assert_eq!(
        one.guidance,
        Guidance::Vsd(Vsd {
            lora_every: 3,
            ..Vsd::default()
        })
    );
    let unknown = serde_json::from_str::<Options>(r#"{"guidance": {"Rsd": {"lora_every": 3}}}"#)
        .unwrap_err()
        .to_string();
    assert!(
        unknown
            .contains("unknown field `lora_every`, expected one of `rate`, `timesteps`, `weight`"),
        "{unknown}"
    );
    let InvalidOption { field, .. } = Options {
        batch: 0,
        ..options()
    }
    .check()
    .unwrap_err();
    assert_eq!(field, "batch");
}
