/** What the results of an experiment hold at one pair of thresholds: lines, standings, growth, duels. */

/** Colours of methods by name, in their order; after the last the first comes again. */
export const HUES = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5", "--series-6"];

/** Return the names of the problems, in their order. */
export function problemsOf(results) {
  return [...new Set(results.repeats.map((repeat) => repeat.problem))];
}

/** Return the methods of a problem with their colours, in their order. */
export function methodsOf(results, problem) {
  const names = new Set(results.repeats.filter((repeat) => repeat.problem === problem).map((repeat) => repeat.method));
  return [...names].map((method, index) => ({ method, colour: HUES[index % HUES.length] }));
}

/** Return a row a method and a row a control: mean, interval, the single values, and what is known beside them. */
export function standingsAt(results, problem, { measure, t_b, d_th, i, j }) {
  const colours = new Map(methodsOf(results, problem).map(({ method, colour }) => [method, colour]));
  return results.standings
    .filter((one) => one.problem === problem && one.measure === measure && one.t_b === t_b && one.d_th === d_th)
    .map((one) => {
      const repeats = results.repeats.filter((repeat) => repeat.problem === problem && repeat.method === one.method);
      const sources = one.control ? repeats.map((repeat) => repeat.control).filter(Boolean) : repeats;
      return {
        ...one, key: `${one.method} ${one.control}`, label: one.control ? `${one.method}, control` : one.method,
        hollow: one.control, colour: colours.get(one.method), values: sources.map((source) => source[measure].at(-1)[i][j]),
        unsafe_share: average(sources.map((source) => (one.control ? source.unsafe_share : source.unsafe / Math.max(1, source.evaluated)))),
        behaviours: one.control ? average(sources.map((source) => source.behaviours_a_scenario)) : null,
        reads_low: one.control && sources.some((source) => source.reads_low),
      };
    });
}

/** Return, for each method or each control, the mean, the least and the most at each share of the budget. */
export function growthAt(results, problem, { measure, i, j }, { control = false } = {}) {
  return methodsOf(results, problem).map(({ method, colour }) => {
    const repeats = results.repeats.filter((repeat) => repeat.problem === problem && repeat.method === method);
    const sources = control ? repeats.map((repeat) => repeat.control).filter(Boolean) : repeats;
    const columns = results.fractions.map((_, place) => sources.map((source) => source[measure][place][i][j]));
    return {
      method, colour, means: columns.map(average), least: columns.map((column) => Math.min(...column)),
      most: columns.map((column) => Math.max(...column)),
    };
  });
}

/** Return the duels of a problem at the chosen thresholds. */
export function duelsAt(results, problem, { measure, t_b, d_th }) {
  return results.duels.filter((one) => one.problem === problem && one.measure === measure && one.t_b === t_b && one.d_th === d_th);
}

/** ``< .001`` or ``0.024``. */
export function pValue(value) {
  return value < 0.001 ? "< .001" : value.toFixed(3);
}

function average(values) {
  return values.length ? values.reduce((total, value) => total + value, 0) / values.length : null;
}
