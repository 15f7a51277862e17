//! Photos are decoded a few at a time, so that a scene of hundreds of large ones does not lie in
//! memory.

use std::sync::atomic::{AtomicUsize, Ordering};

use scene::{Reader, SceneError, Transforms, still_life, write_transforms};

#[test]
fn no_more_photos_are_decoded_ahead_than_there_are_threads() {
    let folder = tempfile::tempdir().unwrap();
    let drawn = still_life(9, (24, 18), 1, 0);
    write_transforms(
        folder.path(),
        &drawn.photos[..7],
        &drawn.photos[7..],
        drawn.bounds,
    )
    .unwrap();
    let reader = Transforms {
        path: folder.path().to_owned(),
        ..Transforms::default()
    };
    let whole = reader.read().unwrap();
    let decoded = AtomicUsize::new(0);
    let mut taken = Vec::new();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build();
    let notes = pool.unwrap().install(|| {
        reader.parse().unwrap().for_each::<_, SceneError>(
            |at, photo| {
                decoded.fetch_add(1, Ordering::SeqCst);
                Ok((at, photo))
            },
            |photo| {
                let ahead = decoded.load(Ordering::SeqCst) - taken.len();
                assert!(ahead <= 2, "{ahead} photos are in memory");
                taken.push(photo);
                Ok(())
            },
        )
    });
    assert_eq!(notes.unwrap(), whole.notes);
    let photos: Vec<_> = whole
        .photos
        .into_iter()
        .chain(whole.test)
        .enumerate()
        .collect();
    assert_eq!(taken, photos);
}
