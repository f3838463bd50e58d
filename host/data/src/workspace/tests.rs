//! Folders of runs.

use super::*;
use serde::Deserialize;

#[derive(Serialize, Deserialize)]
struct Recipe {
    seed: u64,
    #[serde(default)]
    price: f32,
}

fn refusal(folder: &Workspace, recipe: &(impl Serialize + DeserializeOwned)) -> String {
    match folder.claim(recipe) {
        Err(refused @ WorkspaceError::OtherRun { .. }) => refused.to_string(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_folder_belongs_to_its_first_recipe_and_says_what_differs() {
    let place = tempfile::tempdir().unwrap();
    let folder = Workspace::new(place.path().join("run"));
    for _ in 0..2 {
        folder.claim(&Recipe { seed: 1, price: 0.1 }).unwrap();
    }
    let refused = refusal(&folder, &Recipe { seed: 2, price: 0.1 });
    assert!(refused.starts_with(&folder.path("").display().to_string()[..5]), "{refused}");
    assert!(refused.contains("`seed` is 1 there and 2 here; choose another folder"), "{refused}");
    refusal(&folder, &"of another shape".to_owned());
    folder.claim(&Recipe { seed: 1, price: 0.1 }).unwrap();
}

#[test]
fn a_folder_of_an_earlier_program_goes_on_if_what_it_did_not_write_has_its_default() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join(RECIPE), "{\"seed\": 1}").unwrap();
    let folder = Workspace::new(place.path());
    folder.claim(&Recipe { seed: 1, price: 0.0 }).unwrap();
    assert!(refusal(&folder, &Recipe { seed: 1, price: 0.1 }).contains("`price` is 0.0 there"));
}

#[test]
fn a_damaged_recipe_is_no_other_run_and_names_its_file() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join(RECIPE), "{").unwrap();
    let refused = Workspace::new(place.path()).claim(&1).unwrap_err().to_string();
    assert!(refused.contains(RECIPE) && refused.contains("remove it if it is damaged"), "{refused}");
}

#[test]
fn a_part_is_made_once_and_again_after_its_removal() {
    let place = tempfile::tempdir().unwrap();
    let folder = Workspace::new(place.path()).folder("units/1");
    let keep = |made: u32| folder.keep("part.json", || Ok::<_, WorkspaceError>(made)).unwrap();
    assert_eq!((keep(1), keep(2)), (1, 1));
    let failed = folder
        .keep::<u32, _>("other.json", || Err(WorkspaceError::file(Path::new(""))(io::Error::other(""))));
    assert!(failed.is_err() && !folder.path("other.json").exists());
    folder.remove("part.json").unwrap();
    assert_eq!(keep(3), 3);
    let within = folder.folder("breaths");
    within.save("0.json", &0).unwrap();
    folder.remove("breaths").unwrap();
    folder.remove("breaths").unwrap();
    assert!(!within.path("").exists() && folder.path("part.json").exists(), "the others stay");
}
