import {know} from '/said.js';

// Works as fetch(), and takes note of the messages of the answer. If no answer arrives, the error has a text of this page instead of
// the browser's.
export async function fetched(path, options = {}, unanswered = 'there is no connection to the console') {
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    if (options.signal?.aborted) throw error;
    know({text: unanswered, id: unanswered});
    throw new Error(unanswered);
  }
  const refusal = response.headers.get('Abcal-Message'), json = response.json.bind(response);
  if (refusal) know(JSON.parse(refusal));
  response.json = async () => {
    const answer = await json();
    know(answer);
    return answer;
  };
  return response;
}
