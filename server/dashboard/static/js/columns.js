/** Columnar answers as rows. */

/** Return one object a row of an answer whose lists are all as long as its list of `key`. */
export function rowsOf(answer, key = "id") {
  const length = answer[key].length;
  const names = Object.keys(answer).filter((name) => Array.isArray(answer[name]) && answer[name].length === length);
  return answer[key].map((_, index) => Object.fromEntries(names.map((name) => [name, answer[name][index]])));
}
