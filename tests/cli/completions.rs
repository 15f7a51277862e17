//! `completions` and `man`: made from the command line, so that they know all of it.

use std::fs;
use std::process::Command;

use crate::space::Space;

#[test]
fn shells_know_every_command() {
    let space = Space::new();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let said = space.ok(&["completions", shell]);
        for command in ["import", "whence", "fsck"] {
            assert!(said.out.contains(command), "{shell} knows no {command}");
        }
    }
    let said = space.say(&["completions", "tcsh"]);
    assert_eq!(said.code, 2, "{}", said.err);
}

#[test]
fn bash_completes_a_command_and_an_option() {
    if Command::new("bash").arg("--version").output().is_err() {
        eprintln!("there is no bash: not tried");
        return;
    }
    let space = Space::new();
    let script = space.ok(&["completions", "bash"]).out;
    let ask = r#"
        function=$(complete -p srnerf-dag | sed 's/.*-F //; s/ .*//')
        complete_line() {
            COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=()
            "$function" srnerf-dag "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
            echo "${COMPREPLY[@]}"
        }
        complete_line srnerf-dag whe
        complete_line srnerf-dag init --ju
    "#;
    fs::write(space.path("ask.sh"), script + ask).unwrap();
    let answer = Command::new("bash")
        .arg(space.path("ask.sh"))
        .output()
        .unwrap();
    let said = String::from_utf8(answer.stdout).unwrap();
    let error = String::from_utf8_lossy(&answer.stderr);
    assert_eq!(
        said.lines().collect::<Vec<_>>(),
        ["whence", "--judge"],
        "{error}"
    );
}

#[test]
fn every_command_has_a_page() {
    let space = Space::new();
    let said = space.ok(&["man", "-o", "pages"]);
    assert!(said.out.contains("pages/srnerf-dag.1"), "{}", said.out);
    for name in [
        "srnerf-dag",
        "srnerf-dag-init",
        "srnerf-dag-export-ply",
        "srnerf-dag-store-fsck",
    ] {
        let page = fs::read_to_string(space.path(&format!("pages/{name}.1"))).unwrap();
        assert!(page.contains(&format!(".TH {name} 1")), "{page}");
    }
    let page = fs::read_to_string(space.path("pages/srnerf-dag.1")).unwrap();
    assert!(page.contains("Exit codes"), "{page}");
    // A folder that cannot be made.
    let said = space.say(&["man", "-o", "tiny.ron/pages"]);
    assert_eq!(said.code, 2, "{}", said.err);
}
