//! Effects on the mechanics of wire, root and groove.

use crate::effect::LawRequirement::{Pictures, StraightArc, Weight};
use crate::effect::law;
use crate::whisker::whisker_effect::WhiskerEffect;
use wcal_rod::Softening;

/// Friction along the wire in the V-groove: stick inside the cone, slip at its edge, with the
/// history of the whole path. Coulomb friction at a point contact; a groove of half angle a raises
/// the coefficient by up to 1/sin a.
pub(crate) fn groove_friction() -> WhiskerEffect {
    let coulomb = |name| law(name).amplitude("friction_coefficient", "1", [0.0, 0.7], 0.15);
    let two_speed = coulomb("coulomb-two-speed").shape("moving_share", "1", [0.2, 1.5], &[0.75]);
    WhiskerEffect {
        rod: |values, rod| {
            rod.friction += values.of("friction_coefficient");
            if values.law() == "coulomb-two-speed" {
                rod.moving_share = values.of("moving_share");
            }
        },
        ..WhiskerEffect::new(
            "groove-friction",
            "Friction in the V-groove: the contact force has a component along the wire until it slips.",
            vec![coulomb("coulomb"), two_speed],
        )
    }
}

/// Constant offset of the groove in the rig frame (three components; one along the wire is weak):
/// mounting tolerance of the rig.
pub(crate) fn contact_offset() -> WhiskerEffect {
    let offsets = ["offset_x_mm", "offset_y_mm", "offset_z_mm"];
    let rigid = law("rigid").amplitudes(offsets, "mm", [-2.0, 2.0], 0.1);
    WhiskerEffect {
        rod: |values, rod| {
            for (offset, by) in rod.offset_mm.iter_mut().zip(values.all()) {
                *offset += by;
            }
        },
        ..WhiskerEffect::new(
            "contact-offset",
            "The groove is displaced from its stated position by a constant offset.",
            vec![rigid],
        )
    }
}

/// Compliance of the root: potting or mount gives way, and it turns by C m about the transverse
/// axes.
pub(crate) fn base_compliance() -> WhiskerEffect {
    let unit = "rad/(N mm)";
    let isotropic = law("isotropic").amplitude("compliance_rad_per_nmm", unit, [0.0, 0.2], 0.005);
    let two_axis = law("two-axis")
        .amplitude("compliance_y_rad_per_nmm", unit, [0.0, 0.2], 0.005)
        .amplitude("compliance_z_rad_per_nmm", unit, [0.0, 0.2], 0.01);
    WhiskerEffect {
        rod: |values, rod| {
            // One value for both axes, or one each.
            let [y, z] = [values.all()[0], values.all()[values.all().len() - 1]];
            rod.compliance_rad_per_nmm[0] += y;
            rod.compliance_rad_per_nmm[1] += z;
        },
        ..WhiskerEffect::new(
            "base-compliance",
            "The root turns under the moment before the wire bends.",
            vec![isotropic, two_axis],
        )
    }
}

/// Superelastic softening past a yield curvature: NiTi transforms at 0.4-1 % surface strain;
/// section law of a plateau in docs/src/method.md.
pub(crate) fn superelastic_softening() -> WhiskerEffect {
    let softening = |name, most| {
        law(name)
            .amplitude("softening_share", "1", [0.0, most], 0.5)
            .shape(
                "onset_per_m",
                "1/m",
                [12.0, 90.0],
                &[20.0, 30.0, 40.0, 52.0, 65.0],
            )
    };
    WhiskerEffect {
        rod: |values, rod| {
            let share = values.of("softening_share");
            if share <= 0.0 {
                return;
            }
            // Past the onset the tangent modulus is this share of the elastic one.
            let (left, onset_per_m) = (1.0 - share, values.of("onset_per_m"));
            rod.softening = Some(if values.law() == "section-plateau" {
                Softening::Section {
                    onset_per_m,
                    hardening: left,
                }
            } else {
                Softening::Bilinear {
                    onset_per_m,
                    ratio: left,
                }
            });
        },
        ..WhiskerEffect::new(
            "superelastic-softening",
            "Superelastic softening: the alloy begins to transform where the wire is bent most.",
            vec![
                softening("section-plateau", 1.0),
                softening("bilinear", 0.97),
            ],
        )
    }
}

/// Bending stiffness that varies along the wire: EI goes with the fourth power of the diameter.
pub(crate) fn wire_taper() -> WhiskerEffect {
    WhiskerEffect {
        rod: |values, rod| rod.taper += values.of("relative_stiffness_change"),
        ..WhiskerEffect::new(
            "wire-taper",
            "Taper: the wire's diameter changes from root to tip.",
            vec![law("linear-diameter").amplitude(
                "relative_stiffness_change",
                "1",
                [-0.6, 1.5],
                0.1,
            )],
        )
    }
}

/// Weight less buoyancy of the wire: int r x (rho_w - rho_f) A g ds, about 0.008 N mm.
pub(crate) fn gravity() -> WhiskerEffect {
    let weight = law("weight").needing(&[Weight]);
    WhiskerEffect {
        rod: |values, rod| rod.weight += values.of("weight_share"),
        ..WhiskerEffect::new(
            "gravity",
            "The wire bends under its own weight.",
            vec![weight.amplitude("weight_share", "1", [0.0, 1.5], 1.0)],
        )
    }
}

/// The wire at rest is not as declared: its straight part is longer or shorter, its arc flatter or
/// narrower (bending tolerance). The free tail in the pictures shows it with no load.
pub(crate) fn rest_shape() -> WhiskerEffect {
    let bent = law("straight-and-arc")
        .needing(&[Pictures, StraightArc])
        .amplitudes(
            ["straight_change_mm", "arc_radius_change_mm"],
            "mm",
            [-6.0, 6.0],
            0.5,
        );
    WhiskerEffect {
        rod: |values, rod| {
            rod.straight_change_mm += values.of("straight_change_mm");
            rod.arc_radius_change_mm += values.of("arc_radius_change_mm");
        },
        ..WhiskerEffect::new(
            "rest-shape",
            "The rest shape differs from the declared one: straight length or arc radius.",
            vec![bent],
        )
    }
}
