//! Adam against PyTorch, and on a GPU.

use super::*;
use crate::check::{agree, assert_same_bits, check_golden, pattern};

#[test]
fn adam_is_torchs() {
    for (name, weight_decay) in [("adam", 0.0), ("adamw", 0.1)] {
        let adam = Adam {
            rate: 0.01,
            beta2: 0.99,
            weight_decay,
            ..Adam::default()
        };
        let mut parameter = pattern(18, &[9]);
        let mut state = AdamState::new(&parameter);
        for step in 0..3 {
            update(
                &adam,
                &mut parameter,
                &pattern(19 + step, &[9]),
                &mut state,
                step + 1,
            );
        }
        check_golden(name, &parameter);
    }
}

#[test]
fn a_reshape_shares_and_a_change_does_not() {
    let x = pattern(1, &[4, 3]);
    let y = x.reshape(&[3, 4]);
    let mut state = AdamState::new(&x);
    let mut parameter = x.clone();
    update(&Default::default(), &mut parameter, &x, &mut state, 1);
    assert_eq!(x.to_vec(), y.to_vec());
    assert_ne!(parameter.to_vec(), x.to_vec());
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let x = pattern(1, &[2, 3, 130, 129]);
    let dy = pattern(2, &[2, 3, 130, 129]);
    assert_same_bits("adam", || {
        let mut parameter = x.clone();
        let mut state = AdamState::new(&x);
        update(&Adam::default(), &mut parameter, &dy, &mut state, 1);
        vec![parameter, state.m, state.v]
    });
}

/// What a GPU gives beside the CPU. Skipped where there is no adapter.
mod on_a_gpu {
    use super::*;

    #[test]
    fn steps_of_adam() {
        let adam = Adam {
            weight_decay: 0.1,
            ..Adam::default()
        };
        agree(
            "adam",
            &[pattern(1, &[37, 19]), pattern(2, &[37, 19])],
            |x| {
                let mut parameter = x[0].clone();
                let mut state = AdamState::new(&x[0]);
                (1..4).for_each(|step| update(&adam, &mut parameter, &x[1], &mut state, step));
                vec![parameter, state.m, state.v]
            },
        );
    }
}
