//! Leases as two processes see each other's.

use super::*;
use crate::store::{Store, World};

fn key() -> Digest {
    blake3::hash(b"k").into()
}

/// A store whose leases never beat by themselves, and last a minute.
fn store(root: &Path) -> Store {
    let lease_timeouts = LeaseTimeouts {
        beat: Duration::from_secs(3600),
        stale: Duration::from_secs(60),
    };
    let world = World {
        lease_timeouts,
        ..World::default()
    };
    Store::create_in(world, root).unwrap()
}

fn take(store: &Store) -> Option<Lease<'_>> {
    match store.leases.take(&key()).unwrap() {
        Claim::Ours(lease) => Some(lease),
        Claim::Theirs(_) => None,
    }
}

/// Makes a store believe that it has seen all leases as they are for so long.
fn wait(store: &Store, time: Duration) {
    store
        .leases
        .seen
        .lock()
        .unwrap()
        .values_mut()
        .for_each(|(_, since)| *since -= time);
}

#[test]
fn a_lease_is_one_holders_until_it_is_given_back() {
    let folder = tempfile::tempdir().unwrap();
    let a = store(folder.path());
    let b = store(folder.path());
    let held = take(&a).unwrap();
    assert!(take(&b).is_none() && take(&a).is_none());
    drop(held);
    assert!(take(&b).is_some());
    assert_eq!(
        fs::read_dir(folder.path().join("leases")).unwrap().count(),
        0
    );
}

#[test]
fn a_holder_without_a_sign_of_life_is_replaced_and_finds_out() {
    let folder = tempfile::tempdir().unwrap();
    let a = store(folder.path());
    let b = store(folder.path());
    let asleep = take(&a).unwrap();
    assert!(take(&b).is_none());
    wait(&b, Duration::from_secs(59));
    assert!(take(&b).is_none());
    wait(&b, Duration::from_secs(2));
    let awake = take(&b).unwrap();
    assert_eq!(
        (asleep.lost_to().as_ref(), awake.lost_to()),
        (Some(Holder::this_process()), None)
    );
    drop(asleep);
    assert!(
        take(&a).is_none(),
        "the one who lost it must not give back what is another's"
    );
    drop(awake);
    assert!(take(&a).is_some());
}

#[test]
fn a_clock_that_jumps_does_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let a = store(folder.path());
    let b = store(folder.path());
    let held = take(&a).unwrap();
    for clock in [
        SystemTime::UNIX_EPOCH,
        SystemTime::now() + Duration::from_secs(1 << 30),
        SystemTime::now(),
    ] {
        assert!(take(&b).is_none());
        wait(&b, Duration::from_secs(61));
        held.file.set_modified(clock).unwrap();
        assert!(take(&b).is_none(), "it was touched");
    }
    assert_eq!(held.lost_to(), None);
}

#[test]
fn of_many_who_take_over_one_wins() {
    for _ in 0..20 {
        let folder = tempfile::tempdir().unwrap();
        let dead = take(&store(folder.path()))
            .map(|lease| lease.path.clone())
            .unwrap();
        fs::write(&dead, r#"{"host": "far", "pid": 1}"#).unwrap();
        let stores: Vec<Store> = (0..4).map(|_| store(folder.path())).collect();
        for store in &stores {
            assert!(take(store).is_none());
            wait(store, Duration::from_secs(61));
        }
        let won = std::thread::scope(|scope| {
            let takers: Vec<_> = stores
                .iter()
                .map(|store| scope.spawn(|| take(store)))
                .collect();
            takers
                .into_iter()
                .filter_map(|taker| taker.join().unwrap())
                .collect::<Vec<_>>()
        });
        assert_eq!(won.len(), 1);
    }
}

#[test]
fn a_lease_that_is_garbled_or_taken_away_is_no_trap() {
    let folder = tempfile::tempdir().unwrap();
    let a = store(folder.path());
    let b = store(folder.path());
    let held = take(&a).unwrap();
    fs::remove_dir_all(folder.path().join("leases")).unwrap();
    assert!(held.lost_to().is_some());
    drop(held);
    let held = take(&store(folder.path()))
        .map(|lease| lease.path.clone())
        .unwrap();
    fs::write(&held, "").unwrap();
    assert!(take(&b).is_none());
    wait(&b, Duration::from_secs(61));
    assert!(take(&b).is_some());
}
