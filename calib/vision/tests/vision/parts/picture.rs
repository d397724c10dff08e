//! Pictures of several kinds are read alike.

use image::{DynamicImage, ImageBuffer, Luma};
use wcal_vision::picture::{Picture, exif_orientation};

const SIZE: [u32; 2] = [32, 24];

/// Grey values 0 to 254, and some at the largest of `bits`, `shift` bits up in 16.
fn stored(bits: u32, shift: u32) -> DynamicImage {
    let full = (1u32 << bits) - 1;
    let value = |x: u32, y: u32| {
        if x < 3 {
            full
        } else {
            (full * ((7 * x + 5 * y) % 255)).div_ceil(255)
        }
    };
    DynamicImage::from(ImageBuffer::from_fn(SIZE[0], SIZE[1], |x, y| {
        Luma([(value(x, y) << shift) as u16])
    }))
}

#[test]
fn pictures_of_16_bits_and_tiff_are_those_of_8_bits() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str, picture: DynamicImage| {
        let path = folder.path().join(name);
        picture.save(&path).unwrap();
        Picture::read(&path).unwrap()
    };
    let grey = |x: u32, y: u32| {
        if x < 3 {
            255
        } else {
            ((7 * x + 5 * y) % 255) as u8
        }
    };
    let drawn: Vec<u8> = (0..SIZE[0] * SIZE[1])
        .map(|k| grey(k % SIZE[0], k / SIZE[0]))
        .collect();
    for (name, bits, shift) in [
        ("16.png", 16, 0),
        ("12.png", 12, 0),
        ("10.png", 10, 0),
        ("upper.png", 12, 4),
        ("16.tif", 16, 0),
    ] {
        let found = read(name, stored(bits, shift));
        assert_eq!(found.data, drawn, "{name}");
        assert!((found.saturation().0 - 3.0 / 32.0).abs() < 1e-9, "{name}");
    }
    let eight = ImageBuffer::<Luma<u8>, _>::from_raw(SIZE[0], SIZE[1], drawn.clone()).unwrap();
    for name in ["8.png", "8.tif", "8.bmp"] {
        assert_eq!(
            read(name, DynamicImage::from(eight.clone())).data,
            drawn,
            "{name}"
        );
    }
}

#[test]
fn an_orientation_is_seen_and_pixels_stay_as_stored() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    stored(8, 0).into_luma8().save(&path).unwrap();
    let plain = std::fs::read(&path).unwrap();
    assert_eq!(exif_orientation(&path), None);
    // One entry of a TIFF directory: tag 274, a short, 6.
    let entry = [0x12, 1, 3, 0, 1, 0, 0, 0, 6, 0, 0, 0];
    let exif = [&b"Exif\0\0II*\0\x08\0\0\0\x01\0"[..], &entry, &[0; 4]].concat();
    let length = (exif.len() as u16 + 2).to_be_bytes();
    std::fs::write(
        &path,
        [&plain[..2], &[0xff, 0xe1], &length, &exif, &plain[2..]].concat(),
    )
    .unwrap();
    assert_eq!(exif_orientation(&path), Some(6));
    let picture = Picture::read(&path).unwrap();
    assert_eq!([picture.width as u32, picture.height as u32], SIZE);
}
