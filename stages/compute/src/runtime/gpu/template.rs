//! Expands the templates of kernels into WGSL. It knows three directives, each on a line of its
//! own, and no shading language:
//!
//! ```text
//! #for i 4               the lines up to the matching #end, with ${i} = 0, 1, 2, 3
//! #define name           the lines up to the matching #end, under a name
//! #use name A=q B=k      those lines, with ${A} = q and ${B} = k
//! ```
//!
//! A count may be a `${name}` too: one that is 0 or 1 leaves lines out or in. Loops over registers are written out this way: a variable per
//! register stays in one.

use std::collections::BTreeMap;

/// Names and what stands for them.
type Names = BTreeMap<String, String>;

/// The text of `template` with every directive carried out and every `${name}` of `constants`
/// replaced.
pub fn expand(template: &str, constants: &[(&'static str, u32)]) -> String {
    let names = constants
        .iter()
        .map(|(name, value)| ((*name).to_owned(), value.to_string()))
        .collect();
    let lines: Vec<&str> = template.lines().collect();
    let mut blocks = BTreeMap::new();
    let mut out = String::new();
    expand_lines(&lines, &names, &mut blocks, &mut out);
    out
}

fn expand_lines<'t>(
    lines: &[&'t str],
    names: &Names,
    blocks: &mut BTreeMap<String, Vec<&'t str>>,
    out: &mut String,
) {
    let mut at = 0;
    while let Some(line) = lines.get(at) {
        // A directive's own words may hold names, as the count of a loop does.
        let words: Vec<String> = line
            .split_whitespace()
            .map(|word| substitute(word, names))
            .collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        match words[..] {
            ["#for", name, count] => {
                let body = body(&lines[at + 1..]);
                let count: u32 = count
                    .parse()
                    .unwrap_or_else(|_| panic!("template: `{line}` has no count"));
                for value in 0..count {
                    expand_lines(body, &with(names, name, &value.to_string()), blocks, out);
                }
                at += body.len() + 1;
            }
            ["#define", name] => {
                let body = body(&lines[at + 1..]);
                blocks.insert(name.to_owned(), body.to_vec());
                at += body.len() + 1;
            }
            ["#use", name, ref arguments @ ..] => {
                let body = blocks
                    .get(name)
                    .cloned()
                    .unwrap_or_else(|| panic!("template: there is no `{name}`"));
                let pairs = arguments
                    .iter()
                    .filter_map(|argument| argument.split_once('='));
                // Arguments hold within the block only.
                let names = pairs.fold(names.clone(), |names, (name, value)| {
                    with(&names, name, value)
                });
                expand_lines(&body, &names, blocks, out);
            }
            _ => {
                out.push_str(&substitute(line, names));
                out.push('\n');
            }
        }
        at += 1;
    }
}

/// The lines before the `#end` that belongs to the directive before them.
fn body<'l, 't>(lines: &'l [&'t str]) -> &'l [&'t str] {
    let mut depth = 1;
    for (at, line) in lines.iter().enumerate() {
        match line.split_whitespace().next() {
            Some("#for" | "#define") => depth += 1,
            Some("#end") => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return &lines[..at];
        }
    }
    panic!("template: a directive has no #end")
}

fn with(names: &Names, name: &str, value: &str) -> Names {
    let mut names = names.clone();
    names.insert(name.to_owned(), value.to_owned());
    names
}

fn substitute(line: &str, names: &Names) -> String {
    let mut parts = line.split("${");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (name, rest) = part
            .split_once('}')
            .unwrap_or_else(|| panic!("template: `{line}` has an open brace"));
        let value = names
            .get(name)
            .unwrap_or_else(|| panic!("template: nothing stands for `{name}`"));
        out.push_str(value);
        out.push_str(rest);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::expand;

    #[test]
    fn loops_nest_and_blocks_take_arguments() {
        let text = "#define add\nlet ${X}${i} = a${i} + N${N};\n#end\n#for i ${N}\n#use add X=s\n#for j 2\nf(${i}, ${j})\n#end\n#end\nend";
        let expected =
            "let s0 = a0 + N2;\nf(0, 0)\nf(0, 1)\nlet s1 = a1 + N2;\nf(1, 0)\nf(1, 1)\nend\n";
        assert_eq!(expand(text, &[("N", 2)]), expected);
    }

    #[test]
    #[should_panic(expected = "nothing stands for `M`")]
    fn an_unknown_name_is_a_bug() {
        expand("${M}", &[]);
    }
}
