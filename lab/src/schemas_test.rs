//! The JSON documents that `wcal-lab` writes, by their types.

use crate::commands::simulate;
use crate::dataset::{recipe, shard};
use crate::evaluation::document::EvaluationDocument;
use crate::json_reference::{hold, schema};
use std::path::Path;

#[test]
fn schemas_and_reference_are_made_from_the_types() {
    let own = vec![
        schema::<simulate::document::DatasetDocument>("dataset", "dataset.json"),
        schema::<shard::Manifest>("shard", "OBJECT-FIRST.json"),
        schema::<recipe::Recipe>("recipe", "recipe.json"),
        schema::<simulate::slurm::Submission>("submission", "slurm/submission.json"),
        schema::<crate::model_file::Card>("model", "model.json"),
        schema::<EvaluationDocument>("evaluation", "evaluation.json"),
    ];
    hold(&Path::new(env!("CARGO_MANIFEST_DIR")).join(".."), own);
}
